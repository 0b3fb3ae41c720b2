"""Scores of poses of one view in others, from rough ones of many poses to fine ones of a few."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_bof.core import compiled
from slam_bof.geometry import se3
from slam_bof.geometry.projection import (
    ViewArrays,
    by_axis,
    interpolated_depth,
    nearest_pixel,
    project,
    sampled_by_axis,
)
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.types import Array

__all__ = [
    "AgreementScore",
    "agreement_score",
    "rough_score",
    "score_pose",
    "score_poses",
    "score_rows",
]

SCORE_TOLERANCES = ((0.05, 0.02), (0.02, 0.01), (0.01, 0.005))
"""Tolerances in m and as a share of depth, from coarse to fine."""
N_SCORE_POINTS = 500
"""Largest number of points of either view that are compared."""


class AgreementScore(NamedTuple):
    """How well a view agrees with others at given poses, each (n,)."""

    score: Floats
    """Share of inliers minus half the share of free-space violations among the points that can be
    compared, in both directions; the mean over several tolerances."""
    visible_ratio: Floats
    """Share of points that can be compared; the smaller of both directions."""


def agreement_score(
    views: ViewStack, query: int, matches: Indices, T_match_query: Array
) -> AgreementScore:
    """Score poses (n, 4, 4) of the query in the matches (n,), to choose between nearby poses."""
    T_match_query = np.ascontiguousarray(T_match_query, np.float64)
    return AgreementScore(
        *score_rows(
            views.arrays(),
            int(views.rows(query)),
            views.rows(matches),
            T_match_query,
            se3.inverse(T_match_query),
            min(N_SCORE_POINTS, views.n_points),
        )
    )


@compiled
def score_rows(
    views: ViewArrays, query: int, matches: Indices, T: Array, T_back: Array, n_points: int
) -> tuple[Array, Array]:
    """Return score and visible ratio, each (n,), of rows of views at poses and their inverses."""
    score, visible_ratio = np.empty(len(matches)), np.empty(len(matches))
    own = theirs = sampled_by_axis(views, query, n_points)
    for k in range(len(matches)):
        if k == 0 or matches[k] != matches[k - 1]:
            theirs = sampled_by_axis(views, matches[k], n_points)
        worth, n_visible = _worth(views, matches[k], own, T[k])
        worth_back, n_visible_back = _worth(views, query, theirs, T_back[k])
        score[k] = (worth + worth_back) / max(n_visible + n_visible_back, 1)
        visible_ratio[k] = min(n_visible, n_visible_back) / n_points
    return score, visible_ratio


@compiled
def _worth(views: ViewArrays, row: int, points: Array, T: Array) -> tuple[float, int]:
    """Return the worth of points (3, m) at a pose in a view, and how many are compared.

    An inlier counts 1, a violation of free space -0.5; the mean over several tolerances.
    """
    worth, n_visible = 0.0, 0
    found = np.empty_like(points)
    project(views, T, points, found)
    depths_m, width, height = views.depths_m[row], views.width, views.height
    for i in range(found.shape[1]):
        depth_m = found[2, i]
        if depth_m == 0.0:
            continue
        there_m = interpolated_depth(depths_m, width, height, found[0, i], found[1, i])
        if not there_m > 0.0:
            continue
        n_visible += 1
        off_m = depth_m - there_m
        for fixed_m, share in SCORE_TOLERANCES:
            allowed_m = fixed_m + share * depth_m
            if abs(off_m) < allowed_m:
                worth += 1.0 / len(SCORE_TOLERANCES)
            elif off_m < 0.0:
                worth -= 0.5 / len(SCORE_TOLERANCES)
    return worth, n_visible


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
        scores[k] = score_pose(views, row, axes, T[k], tolerance, found)
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
    n_points: int,
    T: Array,
    bonus: Array,
    tolerance: Array,
) -> Floats:
    """Return the lower score of poses (n, 4, 4) of the query in views (n,), plus a bonus (n,).

    The first ``n_points`` sampled points of each view are projected.
    """
    scores = np.empty(len(T))
    own = sampled_by_axis(views, query, n_points)
    theirs, best = own, 0.0
    found, back = np.empty_like(own), np.eye(4)
    for k in range(len(T)):
        if k == 0 or rows[k] != rows[k - 1]:
            theirs, best = sampled_by_axis(views, rows[k], n_points), -np.inf
        scores[k] = bonus[k] + score_pose(views, rows[k], own, T[k], tolerance, found)
        if scores[k] > best:
            for i in range(3):
                back[i, 3] = 0.0
                for j in range(3):
                    back[i, j] = T[k, j, i]
                    back[i, 3] -= T[k, j, i] * T[k, j, 3]
            reverse = bonus[k] + score_pose(views, query, theirs, back, tolerance, found)
            scores[k] = min(scores[k], reverse)
            best = max(best, scores[k])
    return scores


@compiled
def score_pose(
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
