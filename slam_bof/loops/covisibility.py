"""Choice of covisible keyframes: those that see the same surfaces according to the map.

Place recognition corrects the drift of odometry over long paths. Edges between covisible keyframes
correct its small local errors.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.types import Array, Params

__all__ = ["CovisibilityParams", "choose_covisible"]


class CovisibilityParams(Params):
    """Parameters of the choice of covisible keyframes."""

    max_edges: int = Field(
        12,
        ge=0,
        description="Largest number of covisibility edges for a keyframe; 0 turns them off.",
    )
    min_overlap: float = Field(
        0.35,
        gt=0,
        le=1,
        description="Smallest share of the points of a view that must fall into another view.",
    )
    separation: int = Field(
        2,
        gt=0,
        description="Smallest number of keyframes between two that are chosen.",
    )
    max_range_m: float = Field(
        5.0,
        gt=0,
        description="Depth that bounds the frustum of a view, in m.",
    )


def choose_covisible(
    ids: NDArray[np.integer[Any]], overlaps: Array, params: CovisibilityParams
) -> list[int]:
    """Choose up to ``max_edges`` views with the largest overlaps, their ids ``separation`` apart.

    ``ids`` (n,) and ``overlaps`` (n,) are in order of time. Views close in time constrain a pose in
    the same way, so the chosen ones are spread over time.

    >>> overlaps = np.array([0.6, 0.1, 0.5, 0.7, 0.9])
    >>> choose_covisible(np.array([3, 4, 5, 6, 7]), overlaps, CovisibilityParams(separation=2))
    [3, 5, 7]
    """
    left = np.where(overlaps >= params.min_overlap, overlaps, 0.0)
    chosen: list[int] = []
    while len(chosen) < params.max_edges and left.any():
        best = int(ids[left.argmax()])
        chosen.append(best)
        left[np.abs(ids - best) < params.separation] = 0.0
    return sorted(chosen)
