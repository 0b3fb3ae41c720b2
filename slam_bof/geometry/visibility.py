"""How far one view agrees with others at given poses: what both see, and what contradicts.

Points of either view, seen from the other, lie at the depth that the other has there (*seen*), or
would stand in front of what it sees (*blocking*), which cannot be. Points behind what it sees
are hidden, and say nothing.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.geometry.view_stack import Floats, Indices, ProjectedPoints, ViewStack
from slam_bof.types import Array

__all__ = [
    "Agreement",
    "Coverage",
    "PointVisibility",
    "Scores",
    "agreement",
    "classify_points",
    "coverage",
    "scores",
]

BLOCKS = 8, 6
"""Columns and rows of blocks that an image is cut into to see how agreement varies."""
SCORE_TOLERANCES = ((0.05, 0.02), (0.02, 0.01), (0.01, 0.005))
"""Metres and shares of depth: coarse ones tell from afar, fine ones which of two is the better."""


class Agreement(NamedTuple):
    """How far a view agrees with others, each (n,)."""

    inlier_ratio: Floats
    """Share of a view's points that the other sees too; the smaller of both ways."""
    free_space_violation: Floats
    """Share of its points that would block what the other sees; both ways added."""
    visible_ratio: Floats
    """Share of its points that fall where the other has a depth at all; the smaller."""


class Coverage(NamedTuple):
    """How far a view agrees with many others taken together."""

    visible_ratio: float
    """Share of its points that fall where any of the others has a depth."""
    inlier_ratio: float
    """Of these, the share that any of the others sees too."""
    free_space_violation: float
    """Of these, the share that stands in front of what more of the others see than see it."""
    free_space_violation_reverse: float
    """Of the others' points that fall where the view has a depth, the share in front of it."""


class PointVisibility(NamedTuple):
    """What others tell of points, each (n, m) bool."""

    inlier: NDArray[np.bool_]
    violating: NDArray[np.bool_]
    visible: NDArray[np.bool_]
    """Whether the other has a depth there at all."""


def classify_points(
    views: ViewStack, points: Floats, frames: Indices, T: Floats, tolerance: tuple[float, float]
) -> PointVisibility:
    """Tell of points (m, 3), or (n, m, 3), what the frames (n,) see of them at poses (n, 4, 4).

    ``tolerance`` is of depth: metres, and a share of it.
    """
    projected = views.project_points(points, T)
    there, _ = views.depth_at(frames, projected)
    known = there > 0
    off = projected.depth_m - there
    fixed, share = tolerance
    allowed = fixed + share * projected.depth_m
    return PointVisibility(known & (np.abs(off) < allowed), known & (off < -allowed), known)


MIN_FACING = 0.1
"""Surfaces that face the camera less are not continued within a pixel."""


def _depth_beyond(
    views: ViewStack, points: Floats, frames: Indices, T: Floats
) -> tuple[Floats, ProjectedPoints, NDArray[np.bool_]]:
    """Return by how much points (m, 3) lie beyond the surfaces of frames (n,), and where known.

    A surface is continued from the centre of its pixel to where the point falls: on a floor seen at
    a flat angle half a pixel is decimetres of depth, and whole pixels would seem to agree best.
    """
    projected = views.project_points(points, T)
    surface, normals = views.surface_at(frames, projected)
    there = surface[:, 2]
    moved = T[:, :3, :3] @ points.T + T[:, :3, 3:]
    beyond = ((moved - surface) * normals).sum(axis=1)
    towards = (moved * normals).sum(axis=1)
    towards /= np.maximum(projected.depth_m, np.float32(1e-3))
    off = projected.depth_m - there
    np.divide(beyond, towards, out=off, where=np.abs(towards) > MIN_FACING)
    return off, projected, there > 0


class Scores(NamedTuple):
    """How well poses (n,) of one pair of views agree: inliers less half of what stands in the way.

    The mean over several tolerances, as a share of what can be compared.
    """

    score: Floats
    visible_ratio: Floats
    fall: Floats
    """(n,) by how much less than the first one, over the points that both can compare."""
    fall_error: Floats
    """(n,) its standard error, as it varies between blocks of the images: neighbours err alike."""


def scores(
    views: ViewStack, query: int, match: int, T_match_query: Array, n_points: int = 400
) -> Scores:
    """Score poses (n, 4, 4) of a pair of views, and compare them with the first."""
    n = len(T_match_query)
    worth, known, block = [], [], []
    for own, other, T in (
        (query, match, T_match_query),
        (match, query, se3.inverse(T_match_query)),
    ):
        points = views.sampled(own, n_points)
        off, projected, seen = _depth_beyond(views, points, np.full(n, other), T.astype(np.float32))
        total = np.zeros(off.shape, np.float32)
        for fixed, share in SCORE_TOLERANCES:
            allowed = fixed + share * projected.depth_m
            total += np.abs(off) < allowed
            total -= np.float32(0.5) * (off < -allowed)
        total *= seen / np.float32(len(SCORE_TOLERANCES))
        worth.append(total)
        known.append(seen)
        block.append(views.sampled_blocks(own, BLOCKS, n_points))
    both, all_known = np.concatenate(worth, axis=1), np.concatenate(known, axis=1)
    n_known = np.maximum(all_known.sum(axis=1), 1)
    paired = all_known & all_known[0]
    n_paired = np.maximum(paired.sum(axis=1), 1)
    difference = (both[0] - both) * paired
    fall = difference.sum(axis=1) / n_paired
    difference -= fall[:, None] * paired
    n_blocks = BLOCKS[0] * BLOCKS[1]
    blocks = np.concatenate([block[0], block[1] + n_blocks])
    member = np.zeros((len(blocks), 2 * n_blocks), np.float32)
    member[np.arange(len(blocks)), blocks] = 1.0
    squares = np.square(difference @ member).sum(axis=1)
    return Scores(
        both.sum(axis=1) / n_known,
        np.minimum(known[0].mean(axis=1), known[1].mean(axis=1)),
        fall,
        np.sqrt(squares) / n_paired,
    )


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
    """Return what the matches tell of the query's points, and what it tells of theirs."""
    own, theirs = points
    T = T_match_query.astype(np.float32)
    back = se3.inverse(T_match_query).astype(np.float32)
    asked = np.full(len(matches), query)
    return (
        classify_points(views, own, matches, T, tolerance),
        classify_points(views, theirs, asked, back, tolerance),
    )
