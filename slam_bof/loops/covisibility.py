"""Choice of covisible keyframes: those that see the same surfaces according to the map.

Place recognition corrects the drift of odometry over long paths. Edges between covisible keyframes
correct its small local errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import view_overlap
from slam_bof.loops.spread_maxima import spread_maxima
from slam_bof.types import (
    Array,
    Candidate,
    CandidateSource,
    EdgeKind,
    Intrinsics,
    Keyframe,
    Params,
)

__all__ = ["CovisibilityParams", "choose_covisible", "find_covisible"]

N_OVERLAP_POINTS = 200
"""Approximate number of points used to measure the overlap of two keyframes."""


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


def find_covisible(
    keyframes: Sequence[Keyframe],
    points_camera: Array,
    intrinsics: Intrinsics,
    T_map_camera: Array,
    components: NDArray[np.int64],
    params: CovisibilityParams,
    *,
    min_age_s: float,
) -> list[Candidate]:
    """Return pairs of the newest keyframe with others that, by the map, see the same surfaces.

    Those with keyframes of other sessions, or older ones, are candidates for loops.

    Parameters
    ----------
    keyframes
        All K keyframes, the newest last.
    points_camera
        (N, 3) points of the newest one, in its camera.
    intrinsics
        Intrinsics that bound the frustums of all views.
    T_map_camera
        (K, 4, 4) poses of the keyframes.
    components
        (K,) the component of each keyframe, negative if it was culled.
    params
        Parameters of the choice.
    min_age_s
        Age in seconds from which a keyframe of the same session is older.
    """
    newest = keyframes[-1]
    stride = max(1, len(points_camera) // N_OVERLAP_POINTS)
    ids = np.flatnonzero(components[:-1] == components[-1])
    overlaps = view_overlap(
        points_camera[::stride], T_map_camera[-1], T_map_camera[ids], intrinsics, params.max_range_m
    )

    def kind(match: Keyframe) -> EdgeKind:
        is_older = newest.stamp_s - match.stamp_s >= min_age_s
        is_loop = match.session != newest.session or is_older
        return EdgeKind.LOOP if is_loop else EdgeKind.COVISIBILITY

    return [
        Candidate(newest.id, match_id, CandidateSource.PROXIMITY, kind(keyframes[match_id]))
        for match_id in choose_covisible(ids, overlaps, params)
    ]


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
    enough = np.where(overlaps >= params.min_overlap, overlaps, 0.0)
    return sorted(spread_maxima(ids, enough, max_n=params.max_edges, separation=params.separation))
