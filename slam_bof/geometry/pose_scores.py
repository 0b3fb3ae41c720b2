"""Quick and coarse scores of poses, by the depth that few points meet there."""

from __future__ import annotations

import numpy as np

from slam_bof.core import compiled
from slam_bof.geometry.projection import ViewArrays, by_axis, nearest_pixel, project
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.types import Array

__all__ = ["rough_score", "score_poses"]


@compiled
def score_poses(views: ViewArrays, row: int, points: Floats, T: Array, tolerance: Array) -> Array:
    """Score poses (n, 4, 4) of points (m, 3) in one view, one way only: quick, and coarse.

    The better points lie within the ``tolerance`` (2,), in m and as a share of depth, the more they
    count, up to 1; violations of free space cost 0.5.
    """
    scores = np.empty(len(T))
    axes = by_axis(points)
    found = np.empty_like(axes)
    for k in range(len(T)):
        scores[k] = _score_pose(views, row, axes, T[k], tolerance, found)
    return scores


def rough_score(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Array,
    bonus: Array,
    n_points: int,
    tolerance: tuple[float, float],
) -> Floats:
    """Score poses (n, 4, 4) of the query in the matches (n,) as ``score_poses`` does, both ways.

    The lower score counts, and a ``bonus`` (n,) is added. Of poses of one match that follow each
    other, those that cannot become the best any more are scored one way only.
    """
    return _score_both_ways(
        views.arrays(),
        views.rows(matches),
        int(views.rows(query)),
        views.pixels(),
        n_points,
        np.ascontiguousarray(T_match_query, np.float64),
        bonus,
        np.array(tolerance),
    )


@compiled
def _score_both_ways(
    views: ViewArrays,
    rows: Indices,
    query: int,
    pixels: Indices,
    n_points: int,
    T: Array,
    bonus: Array,
    tolerance: Array,
) -> Floats:
    """Return the lower score of poses (n, 4, 4) of the query in views (n,), plus a bonus (n,).

    The points of the first ``n_points`` of ``pixels`` (V, m) of each view are projected.
    """
    scores = np.empty(len(T))
    own = _points_by_axis(views, query, pixels[query, :n_points])
    theirs, best = own, 0.0
    found, back = np.empty_like(own), np.eye(4)
    for k in range(len(T)):
        if k == 0 or rows[k] != rows[k - 1]:
            theirs, best = _points_by_axis(views, rows[k], pixels[rows[k], :n_points]), -np.inf
        scores[k] = bonus[k] + _score_pose(views, rows[k], own, T[k], tolerance, found)
        if scores[k] > best:
            for i in range(3):
                back[i, 3] = 0.0
                for j in range(3):
                    back[i, j] = T[k, j, i]
                    back[i, 3] -= T[k, j, i] * T[k, j, 3]
            reverse = bonus[k] + _score_pose(views, query, theirs, back, tolerance, found)
            scores[k] = min(scores[k], reverse)
            best = max(best, scores[k])
    return scores


@compiled
def _points_by_axis(views: ViewArrays, row: int, pixels: Indices) -> Array:
    """Return the points (3, m) of some pixels (m,) of a view."""
    points = np.empty((3, len(pixels)))
    for i in range(len(pixels)):
        pixel = pixels[i]
        for axis in range(3):
            points[axis, i] = views.rays[pixel, axis] * views.depths_m[row, pixel]
    return points


@compiled
def _score_pose(
    views: ViewArrays, row: int, axes: Array, T: Array, tolerance: Array, found: Array
) -> float:
    """Score one pose (4, 4) of points (3, m); ``found`` (3, m) is overwritten."""
    score = 0.0
    depths_m = views.depths_m[row]
    project(views, T, axes, found)
    for i in range(axes.shape[1]):
        if found[2, i] == 0.0:
            continue
        there_m = depths_m[nearest_pixel(views.width, found[0, i], found[1, i])]
        if not there_m > 0.0:
            continue
        off = (found[2, i] - there_m) / (tolerance[0] + tolerance[1] * there_m)
        score += max(1.0 - abs(off), 0.0) if off >= -1.0 else -0.5
    return float(score / axes.shape[1])
