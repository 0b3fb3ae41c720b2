"""``slam-bof version`` and ``slam-bof --version``."""

from __future__ import annotations

import typer

from slam_bof.cli.options import JSON

__all__ = ["print_version", "version"]


def version(as_json: JSON = False) -> None:
    """Print the version of slam_bof."""
    from importlib import metadata

    from slam_bof.cli.console import print_json

    number = metadata.version("slam-bof")
    if as_json:
        print_json({"version": number})
    else:
        typer.echo(f"slam-bof {number}")


def print_version(is_asked: bool) -> None:
    """Print the version and exit, if it is asked for."""
    if is_asked:
        version()
        raise typer.Exit
