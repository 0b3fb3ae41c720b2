"""The data that the plan of a map is drawn from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes import MapRoom
from slam_bof.types import Array, Pose

__all__ = ["Plan"]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The occupancy grid of a component of a map, and its rooms.

    ``cells`` (rows, columns), ``resolution_m``, ``origin_m`` and ``T_plan_map`` (4, 4) are those
    of ``maps.OccupancyGrid``. ``positions_map`` (K, 3) are those of all keyframes, to which the
    ``keyframe_ids`` of ``rooms`` refer. ``ways`` are the ids of keyframes of the component that
    follow each other in one session.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin_m: tuple[float, float]
    T_plan_map: Pose
    positions_map: Array
    rooms: Sequence[MapRoom]
    ways: Sequence[Sequence[int]]
