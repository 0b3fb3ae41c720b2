"""The Typer application: its commands, and one line on stderr for mistakes of the user."""

from __future__ import annotations

import io
import logging
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from slam_bof.cli.atlas import app as atlas
from slam_bof.cli.bench import bench
from slam_bof.cli.check import check
from slam_bof.cli.config import config
from slam_bof.cli.demo import demo
from slam_bof.cli.doctor import doctor
from slam_bof.cli.download import download
from slam_bof.cli.evaluate import app as evaluate
from slam_bof.cli.export import export
from slam_bof.cli.localize import localize
from slam_bof.cli.map import app as map_tools
from slam_bof.cli.one_line import one_line
from slam_bof.cli.options import NumbersCommand
from slam_bof.cli.plugins import plugins
from slam_bof.cli.query import app as query
from slam_bof.cli.record import record
from slam_bof.cli.report import report
from slam_bof.cli.run import INTERRUPTED, run
from slam_bof.cli.show import show
from slam_bof.cli.train import train
from slam_bof.cli.version import print_version, version
from slam_bof.cli.view import view
from slam_bof.core import unwrap_interruption
from slam_bof.errors import SlamBofError

__all__ = ["app", "main"]


class OneLineErrors(TyperGroup):
    """Commands that report a user's mistake as ``error: ...``, and a bug as a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            with unwrap_interruption():
                return super().invoke(ctx)
        except SlamBofError as error:
            fail(str(error), 1)
        except BrokenPipeError:
            # The reader of the output has closed it, so there is no one to print to.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            raise typer.Exit(1) from None
        except OSError as error:
            if error.errno is None:
                raise
            place = f"{error.filename}: " if error.filename else ""
            fail(f"{place}{error.strerror}", 1)
        except KeyboardInterrupt:
            fail("interrupted", INTERRUPTED)


def fail(message: str, code: int) -> None:
    """Print an error in one line, and exit."""
    typer.echo(f"error: {one_line(message)}", err=True)
    raise typer.Exit(code)


app = typer.Typer(
    name="slam-bof",
    cls=OneLineErrors,
    help="Depth-only place recognition, loop closing and scene labels.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@app.callback()
def _options(
    show_version: Annotated[
        bool,
        typer.Option(
            "--version", is_eager=True, callback=print_version, help="Print the version and exit."
        ),
    ] = False,
) -> None:
    """Depth-only place recognition, loop closing and scene labels."""
    root = logging.getLogger()
    if not any(isinstance(handler, ShowWarnings) for handler in root.handlers):
        root.addHandler(ShowWarnings())


class ShowWarnings(logging.Handler):
    """Prints warnings of all libraries on stderr, but those of a run, which its bar shows."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.addFilter(lambda record: record.name != "slam_bof.run.logging_observer")

    def emit(self, record: logging.LogRecord) -> None:
        """Print a warning in one line."""
        typer.echo(f"warning: {one_line(record.getMessage())}", err=True)


for command in (
    *(demo, run, check, localize, show, view, report, export, train),
    *(bench, download, record, plugins, config, doctor, version),
):
    app.command(cls=NumbersCommand if command in (localize, show) else None)(command)
app.add_typer(query, name="query")
app.add_typer(evaluate, name="evaluate")
app.add_typer(map_tools, name="map")
app.add_typer(atlas, name="atlas")


def main() -> None:
    """Run the command line."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # names of files may be no text
            stream.reconfigure(errors="backslashreplace")
    try:
        app(prog_name="slam-bof")
    except KeyboardInterrupt:  # before a command has begun
        typer.echo("error: interrupted", err=True)
        sys.exit(INTERRUPTED)
