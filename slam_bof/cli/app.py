"""The Typer application: its commands, and one line on stderr for what the user can mend."""

from __future__ import annotations

import os
from typing import Any

import typer
from typer.core import TyperGroup

from slam_bof.cli.bench import bench
from slam_bof.cli.doctor import config, doctor, plugins, version
from slam_bof.cli.download import download, record
from slam_bof.cli.evaluate_places import evaluate
from slam_bof.cli.export import export, report
from slam_bof.cli.localize import localize
from slam_bof.cli.map import app as map_tools
from slam_bof.cli.query import query
from slam_bof.cli.run import demo, run
from slam_bof.cli.tables import ListCommand
from slam_bof.cli.train import train
from slam_bof.errors import SlamBofError

__all__ = ["app", "main"]

INTERRUPTED = 130  # as shells have it: 128 + SIGINT


class OneLineErrors(TyperGroup):
    """Commands whose user's mistakes end in ``error: ...`` and exit code 1, bugs in a traceback."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        try:
            return super().invoke(ctx)
        except SlamBofError as error:
            fail(str(error), 1)
        except BrokenPipeError:
            # Whoever read the output has had enough; there is nobody left to tell.
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            raise typer.Exit(1) from None
        except OSError as error:
            if error.errno is None:
                raise
            place = f"{error.filename}: " if error.filename else ""
            fail(f"{place}{error.strerror}", 1)
        except KeyboardInterrupt:
            fail("interrupted; what was written stays", INTERRUPTED)


def fail(message: str, code: int) -> None:
    """Say what is wrong in one line, and leave."""
    typer.echo(f"error: {' '.join(message.splitlines())}", err=True)
    raise typer.Exit(code)


app = typer.Typer(
    name="slam-bof",
    cls=OneLineErrors,
    help="Depth-only place recognition, loop closing and scene labels.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
for command in (
    *(demo, run, query, localize, report, export, train),
    *(bench, download, record, plugins, config, doctor, version),
):
    app.command(cls=ListCommand if command in (query, localize) else None)(command)
app.add_typer(evaluate, name="evaluate")
app.add_typer(map_tools, name="map")


def main() -> None:
    """Run the command line."""
    app(prog_name="slam-bof")
