"""``slam-bof view``: a saved map in the viewer of rerun."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slam_bof.cli.inputs import map_file
from slam_bof.cli.options import MAP, QUIET
from slam_bof.errors import ConfigError

__all__ = ["view"]


def view(
    map_: MAP,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="FILE.rrd", help="Record it, and open no viewer."),
    ] = None,
    quiet: QUIET = False,
) -> None:
    """Show a saved map in the viewer of rerun (extra view), keyframe by keyframe."""
    from slam_bof.maps import show_map
    from slam_bof.store import MapStore
    from slam_bof.visualization import LIVE

    if out is not None and out.suffix != ".rrd":
        raise ConfigError(f"--out {out}: found {out.suffix or 'no suffix'}, expected .rrd")
    with MapStore.open(map_file(map_)) as store:
        n = show_map(store, LIVE if out is None else str(out))
    if not quiet:
        typer.echo(f"{n} keyframes: {'in the viewer' if out is None else out}")
