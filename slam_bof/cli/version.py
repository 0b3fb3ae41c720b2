"""``slam-bof version`` and ``slam-bof --version``."""

from __future__ import annotations

import typer

from slam_bof.cli.options import JSON

__all__ = ["print_version", "version"]


def version(as_json: JSON = False) -> None:
    """Print the version of slam_bof."""
    import slam_bof
    from slam_bof.cli.console import print_json

    if as_json:
        print_json({"version": slam_bof.__version__})
    else:
        typer.echo(f"slam-bof {slam_bof.__version__}")


def print_version(is_asked: bool) -> None:
    """Print the version and exit, if it is asked for."""
    if is_asked:
        version()
        raise typer.Exit
