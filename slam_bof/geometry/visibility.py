"""How far one view agrees with others at given poses: what both see, and what contradicts.

Points of either view, projected into the other, lie at the depth that the other has there (inliers)
or in front of what it sees, which violates its free space. Points behind what it sees are hidden,
and say nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.geometry import se3
from slam_bof.geometry.projection import (
    ViewArrays,
    by_axis,
    nearest_pixel,
    project,
    sampled_by_axis,
)
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.types import Array

__all__ = [
    "Agreement",
    "Coverage",
    "PointVisibility",
    "agreement",
    "classify_points",
    "coverage",
]


class Agreement(NamedTuple):
    """How far a view agrees with others, each (n,)."""

    inlier_ratio: Floats
    """Share of a view's points that are inliers in the other; the smaller of both ways."""
    free_space_violation: Floats
    """Share of its points in front of what the other sees; both ways added."""
    visible_ratio: Floats
    """Share of its points that fall where the other has a depth at all; the smaller."""


class Coverage(NamedTuple):
    """How far a view agrees with many others taken together."""

    visible_ratio: float
    """Share of its points that fall where any of the others has a depth."""
    inlier_ratio: float
    """Of these, the share that are inliers in any of the others."""
    free_space_violation: float
    """Of these, the share that stands in front of what more of the others see than see it."""
    free_space_violation_reverse: float
    """Of the others' points that fall where the view has a depth, the share in front of it."""


class PointVisibility(NamedTuple):
    """How points (m,) appear in other views (n,), each (n, m) bool."""

    inlier: NDArray[np.bool_]
    violating: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    """Whether the other has a depth there at all."""


def classify_points(
    views: ViewStack, points: Floats, frames: Indices, T: Array, tolerance: tuple[float, float]
) -> PointVisibility:
    """Compare points (m, 3), or (n, m, 3), at poses (n, 4, 4) with the depth of frames (n,).

    ``tolerance`` is that of depth, in m and as a share of depth.
    """
    each = points if points.ndim == 3 else points[None]
    T = np.ascontiguousarray(T, np.float64)
    return PointVisibility(*_classify(views.arrays(), views.rows(frames), each, T, *tolerance))


@compiled
def _classify(
    views: ViewArrays,
    rows: Indices,
    points: Floats,
    T: Array,
    fixed_m: float,
    share: float,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return what is inlier, violating and visible, each (n, m), of points (1 or n, m, 3)."""
    shape = (len(rows), points.shape[1])
    inlier = np.zeros(shape, np.bool_)
    violating = np.zeros(shape, np.bool_)
    visible = np.zeros(shape, np.bool_)
    found = np.empty((3, points.shape[1]))
    for k in range(len(rows)):
        project(views, T[k], by_axis(points[min(k, len(points) - 1)]), found)
        depths_m = views.depths_m[rows[k]]
        for i in range(found.shape[1]):
            depth_m = found[2, i]
            if depth_m == 0.0:
                continue
            there_m = depths_m[nearest_pixel(views.width, found[0, i], found[1, i])]
            if not there_m > 0.0:
                continue
            off_m = depth_m - there_m
            allowed_m = fixed_m + share * depth_m
            inlier[k, i] = abs(off_m) < allowed_m
            violating[k, i] = off_m < -allowed_m
            visible[k, i] = True
    return inlier, violating, visible


def agreement(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Array,
    tolerance: tuple[float, float],
) -> Agreement:
    """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
    T_match_query = np.ascontiguousarray(T_match_query, np.float64)
    out, back = _count_both_ways(
        views.arrays(),
        int(views.rows(query)),
        views.rows(matches),
        T_match_query,
        se3.inverse(T_match_query),
        views.n_points,
        *tolerance,
    )
    return Agreement(
        np.minimum(out[0], back[0]) / views.n_points,
        (out[1] + back[1]) / views.n_points,
        np.minimum(out[2], back[2]) / views.n_points,
    )


@compiled
def _count_both_ways(
    views: ViewArrays,
    query: int,
    matches: Indices,
    T: Array,
    T_back: Array,
    n_points: int,
    fixed_m: float,
    share: float,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Count what is inlier, violating and visible of the query's points, and of the matches'.

    Both are (3, n), of rows of views at poses (n, 4, 4) and their inverses.
    """
    out, back = np.zeros((3, len(matches)), np.intp), np.zeros((3, len(matches)), np.intp)
    own = sampled_by_axis(views, query, n_points)
    found = np.empty_like(own)
    for k in range(len(matches)):
        _count(views, matches[k], own, T[k], fixed_m, share, found, out[:, k])
        theirs = sampled_by_axis(views, matches[k], n_points)
        _count(views, query, theirs, T_back[k], fixed_m, share, found, back[:, k])
    return out, back


@compiled
def _count(
    views: ViewArrays,
    row: int,
    points: Array,
    T: Array,
    fixed_m: float,
    share: float,
    found: Array,
    counts: NDArray[np.intp],
) -> None:
    """Count which points (3, m) are inlier, violating and visible in a view."""
    project(views, T, points, found)
    depths_m = views.depths_m[row]
    for i in range(found.shape[1]):
        depth_m = found[2, i]
        if depth_m == 0.0:
            continue
        there_m = depths_m[nearest_pixel(views.width, found[0, i], found[1, i])]
        if not there_m > 0.0:
            continue
        off_m = depth_m - there_m
        allowed_m = fixed_m + share * depth_m
        counts[0] += abs(off_m) < allowed_m
        counts[1] += off_m < -allowed_m
        counts[2] += 1


def coverage(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Array,
    tolerance: tuple[float, float],
) -> Coverage:
    """Measure how far the query agrees with all matches (n,) together, at poses (n, 4, 4).

    What one of them does not see, as it is hidden from there, another may. Only points on surfaces
    are looked at: at edges sensors err.
    """
    points = views.surface_points(query), views.surface_points(matches)
    out, back = _both_ways(views, query, matches, T_match_query, tolerance, points)
    n_inliers, n_violations, n_visible = (visibility.sum(axis=0) for visibility in out)
    visible_ratio = float((n_visible > 0).mean())
    n_visible_points = max(int((n_visible > 0).sum()), 1)
    return Coverage(
        visible_ratio,
        float((n_inliers > 0).sum() / n_visible_points),
        float((n_violations > n_inliers).sum() / n_visible_points),
        float(back.violating.sum() / max(int(back.visible.sum()), 1)),
    )


def _both_ways(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Array,
    tolerance: tuple[float, float],
    points: tuple[Floats, Floats],
) -> tuple[PointVisibility, PointVisibility]:
    """Compare the query's points with the matches, and the matches' points with the query."""
    own, theirs = points
    back = se3.inverse(T_match_query)
    asked = np.full(len(matches), query)
    return (
        classify_points(views, own, matches, T_match_query, tolerance),
        classify_points(views, theirs, asked, back, tolerance),
    )
