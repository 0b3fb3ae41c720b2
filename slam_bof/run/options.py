"""What a run is asked for beside its configuration, which is kept with the map."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RunOptions"]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """How far a run goes, and how it writes ``map.ply``.

    Parameters
    ----------
    max_frames
        Stop after this many frames; None for all.
    with_color
        Give the points of ``map.ply`` the data set's colour, which may show people.
    z_up
        Write ``map.ply`` in a frame with z up and 0 on the floor instead of that of the map.
    """

    max_frames: int | None = None
    with_color: bool = False
    z_up: bool = False
