"""``slam-bof evaluate``: its subcommands."""

from __future__ import annotations

import typer

from slam_bof.cli.evaluate_places import places
from slam_bof.cli.evaluate_scenes import scenes

__all__ = ["app"]

app = typer.Typer(
    help="Evaluate place recognition and scene labels by ground truth.", no_args_is_help=True
)
app.command()(places)
app.command()(scenes)
