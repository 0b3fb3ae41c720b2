"""``slam-bof config``: a configuration in full, with a comment on every parameter."""

from __future__ import annotations

from typing import Annotated

import typer

from slam_bof.cli.options import JSON, SET

__all__ = ["config"]


def config(
    name: Annotated[
        str, typer.Argument(metavar="PRESET|FILE", help="The configuration to print.")
    ] = "indoor",
    assignments: SET = None,
    as_json: JSON = False,
) -> None:
    """Check a configuration, plug-ins included, and print all its parameters.

    Comments give the description, unit and range of each parameter; a file with this output can be
    used with run --config.
    """
    from slam_bof.cli.console import print_json
    from slam_bof.slam import config as configs, dump_with_comments

    chosen = configs.complete(configs.override(configs.resolve(name), assignments or []))
    if as_json:
        print_json(chosen.model_dump(mode="json"))
    else:
        typer.echo(dump_with_comments(chosen), nl=False)
