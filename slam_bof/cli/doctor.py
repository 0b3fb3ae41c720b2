"""Commands about the installation: ``plugins``, ``config``, ``doctor`` and ``version``."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from slam_bof.cli.options import JSON, SET

__all__ = ["config", "doctor", "plugins", "version"]


def plugins(
    check: Annotated[
        bool, typer.Option("--check", help="Load each, to see whether that works.")
    ] = False,
    as_json: JSON = False,
) -> None:
    """List the installed plug-ins, and which optional libraries they lack.

    Exit code 1 if one that lacks nothing does not load when checked.
    """
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.core import registry
    from slam_bof.errors import PluginError

    found, broken = [], False
    for item in registry.listing():
        lacks = registry.missing(item)
        state = lacks or "installed"
        if check and not lacks.startswith("needs"):
            try:
                registry.load(item.port, item.name)
                state = "ok"
            except PluginError as error:
                state = str(error)
                broken = True
        found.append({**asdict(item), "state": state})
    if as_json:
        print_json(found)
    else:
        columns = ("port", "name", "target", "distribution", "version", "state")
        print_table(columns, [[row[column] for column in columns] for row in found])
    if broken:
        raise typer.Exit(1)


def config(
    name: Annotated[str, typer.Argument(metavar="PRESET|FILE", help="What to show.")] = "indoor",
    assignments: SET = None,
    as_json: JSON = False,
) -> None:
    """Print a configuration in full, defaults included; a file is checked, plug-ins and all."""
    from slam_bof.cli.console import print_json
    from slam_bof.slam import config as configs

    chosen = configs.complete(configs.override(configs.resolve(name), assignments or []))
    if as_json:
        print_json(chosen.model_dump(mode="json"))
    else:
        typer.echo(configs.dump(chosen), nl=False)


def doctor(as_json: JSON = False) -> None:
    """Look over what slam_bof needs here; exit code 1 if something is wrong."""
    from slam_bof.cli.console import print_json, print_table
    from slam_bof.cli.doctor_checks import examine

    findings = examine()
    if as_json:
        print_json([asdict(finding) for finding in findings])
    else:
        rows = [(f.what, "ok" if f.ok else "PROBLEM", f.found, f.remedy) for f in findings]
        print_table(("", "state", "found", "remedy"), rows)
    if not all(finding.ok for finding in findings):
        raise typer.Exit(1)


def version(as_json: JSON = False) -> None:
    """Print the version of slam_bof."""
    from importlib import metadata

    from slam_bof.cli.console import print_json

    number = metadata.version("slam-bof")
    if as_json:
        print_json({"version": number})
    else:
        typer.echo(f"slam-bof {number}")
