"""Views of random rooms as data sets, rendered in memory when they are read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from slam_bof.synthetic.rooms import ROOM_KINDS
from slam_bof.synthetic.scene import KINECT
from slam_bof.synthetic.views import shaded_views
from slam_bof.types import DepthFrame

__all__ = ["RoomViews", "make_gallery"]

Rendered = tuple[tuple[DepthFrame, NDArray[np.uint8]], ...]


class RoomViews:
    """Views of one random room, with the shading of its surfaces as grey image.

    The room is rendered when the first view is read, and dropped when another room is rendered.
    """

    name: ClassVar[str] = "synthetic rooms"
    intrinsics = KINECT

    def __init__(self, kind: str, seed: int, n_views: int) -> None:
        self.sequence = f"{kind}-{seed}"
        self._room = kind, seed, n_views

    def __len__(self) -> int:
        """Return the number of views."""
        return self._room[2]

    def frame(self, index: int) -> DepthFrame:
        """Return a view, 640x480 uint16 mm, through the sensor model."""
        return _render(*self._room)[index][0]

    def color(self, index: int) -> None:
        """Return None, as there is no colour."""

    def gray(self, index: int) -> NDArray[np.uint8]:
        """Return the shading, (480, 640), with a lamp beside the camera."""
        return _render(*self._room)[index][1]

    def groundtruth(self) -> None:
        """Return None, as the views are not a sequence."""

    def scenes(self) -> tuple[str, ...]:
        """Return the kind of the room, for every view."""
        return (self._room[0],) * len(self)


def make_gallery(
    seeds: Sequence[int], n_views: int, *, kinds: Sequence[str] = ROOM_KINDS
) -> list[RoomViews]:
    """Return a room of each kind for each seed."""
    return [RoomViews(kind, seed, n_views) for seed in seeds for kind in kinds]


@lru_cache(maxsize=1)
def _render(kind: str, seed: int, n_views: int) -> Rendered:
    return tuple(shaded_views(kind, seed, n_views))
