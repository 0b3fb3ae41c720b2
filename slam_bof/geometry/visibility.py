"""How far one view agrees with others at given poses: what both see, and what contradicts.

Points of either view, projected into the other, lie at the depth that the other has there (inliers)
or in front of what it sees, which violates its free space. Points behind what it sees are hidden,
and say nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.types import Array

__all__ = [
    "Agreement",
    "AgreementScore",
    "Coverage",
    "PointVisibility",
    "agreement",
    "agreement_score",
    "classify_points",
    "coverage",
]


SCORE_TOLERANCES = ((0.05, 0.02), (0.02, 0.01), (0.01, 0.005))
"""Tolerances in m and as a share of depth, from coarse to fine."""
N_SCORE_POINTS = 500


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


class AgreementScore(NamedTuple):
    """How well a view agrees with others at given poses, each (n,)."""

    score: Floats
    """Share of inliers minus half the share of free-space violations among the points that can be
    compared, in both directions; the mean over several tolerances."""
    visible_ratio: Floats
    """Share of points that can be compared; the smaller of both directions."""


class PointVisibility(NamedTuple):
    """How points (m,) appear in other views (n,), each (n, m) bool."""

    inlier: NDArray[np.bool_]
    violating: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    """Whether the other has a depth there at all."""


def classify_points(
    views: ViewStack, points: Floats, frames: Indices, T: Floats, tolerance: tuple[float, float]
) -> PointVisibility:
    """Compare points (m, 3), or (n, m, 3), at poses (n, 4, 4) with the depth of frames (n,).

    ``tolerance`` is that of depth, in m and as a share of depth.
    """
    projected = views.project_points(points, T)
    there, _ = views.depth_at(frames, projected)
    known = there > 0
    off = projected.depth_m - there
    fixed, share = tolerance
    allowed = fixed + share * projected.depth_m
    return PointVisibility(known & (np.abs(off) < allowed), known & (off < -allowed), known)


def agreement(
    views: ViewStack,
    query: int,
    matches: Indices,
    T_match_query: Array,
    tolerance: tuple[float, float],
) -> Agreement:
    """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
    points = views.sampled(query), views.sampled(matches)
    out, back = _both_ways(views, query, matches, T_match_query, tolerance, points)
    inlier_ratio, free_space_violation, visible_ratio = (
        visibility.mean(axis=1) for visibility in out
    )
    inlier_ratio_reverse, free_space_violation_reverse, visible_ratio_reverse = (
        visibility.mean(axis=1) for visibility in back
    )
    return Agreement(
        np.minimum(inlier_ratio, inlier_ratio_reverse),
        free_space_violation + free_space_violation_reverse,
        np.minimum(visible_ratio, visible_ratio_reverse),
    )


def agreement_score(
    views: ViewStack, query: int, matches: Indices, T_match_query: Array
) -> AgreementScore:
    """Score poses (n, 4, 4) of the query in the matches (n,), to choose between nearby poses."""
    n_compared = np.zeros(len(matches))
    worth = np.zeros(len(matches))
    visible_ratio = np.ones(len(matches))
    for points, others, T in (
        (views.sampled(query, N_SCORE_POINTS), matches, T_match_query),
        (
            views.sampled(matches, N_SCORE_POINTS),
            np.full(len(matches), query),
            se3.inverse(T_match_query),
        ),
    ):
        projected = views.project_points(points, T.astype(np.float32))
        there, _ = views.interpolated_depth_at(others, projected)
        known = there > 0
        off = projected.depth_m - there
        for fixed, share in SCORE_TOLERANCES:
            allowed = fixed + share * projected.depth_m
            worth += (known & (np.abs(off) < allowed)).sum(axis=1)
            worth -= 0.5 * (known & (off < -allowed)).sum(axis=1)
        n_compared += known.sum(axis=1)
        visible_ratio = np.minimum(visible_ratio, known.mean(axis=1))
    score = worth / (len(SCORE_TOLERANCES) * np.maximum(n_compared, 1.0))
    return AgreementScore(score, visible_ratio)


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
    T = T_match_query.astype(np.float32)
    back = se3.inverse(T_match_query).astype(np.float32)
    asked = np.full(len(matches), query)
    return (
        classify_points(views, own, matches, T, tolerance),
        classify_points(views, theirs, asked, back, tolerance),
    )
