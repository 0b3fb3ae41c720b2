"""``slam-bof plugins``: the plug-ins that are installed."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from slam_bof.cli.options import JSON

__all__ = ["plugins"]


def plugins(
    check: Annotated[
        bool, typer.Option("--check", help="Import each plug-in and report errors.")
    ] = False,
    as_json: JSON = False,
) -> None:
    """List the installed plug-ins, and the optional libraries that they lack.

    With --check, the exit code is 1 if a plug-in that lacks nothing cannot be imported.
    """
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.core import registry
    from slam_bof.errors import PluginError

    found, is_broken = [], False
    for item in registry.listing():
        missing = registry.missing(item)
        state = missing or "installed"
        if check and not missing.startswith("needs"):
            try:
                registry.load(item.port, item.name)
                state = "ok"
            except PluginError as error:
                state = str(error)
                is_broken = True
        found.append({**asdict(item), "state": state})
    if as_json:
        print_json(found)
    else:
        columns = ("port", "name", "target", "distribution", "version", "state")
        print_table(columns, [[row[column] for column in columns] for row in found])
    if is_broken:
        raise typer.Exit(1)
