"""The motions that most BOF correspondences of a query with each of many views agree on.

A random sample of RANSAC (Fischler and Bolles 1981) needs one correspondence only, for that is a
whole motion; so all are tried, the one with which most others agree wins, and the motion is fitted
to those. Further motions are found in the same way among the correspondences that are left.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation_correspondences import Correspondences, MatchingParams
from slam_bof.core import compiled

__all__ = ["Consensus", "Motions", "find_motions"]

MAX_TRIED = 24
"""Number of correspondences of a view, the first ones, whose motions are tried."""
MIN_AGREEMENT = np.float32(0.1)
"""Smallest agreement, by the kernel, of a correspondence that counts as an inlier."""
ZERO, ONE = np.float32(0.0), np.float32(1.0)
PER_REACH2 = np.float32(1 / 64)
"""Motions farther apart than 8 widths of the kernel do not agree at all."""


class Motions(NamedTuple):
    """Poses of the query's levelled frame in those of V views.

    ``yaw`` (V,) is in rad; ``shift`` (V,), as ``x + i z``, and ``height`` (V,) are in m.
    """

    yaw: NDArray[np.float64]
    shift: NDArray[np.complex128]
    height: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer[Any]] | slice) -> Motions:
        """Return some rows."""
        columns: tuple[NDArray[Any], ...] = self
        return Motions(*(column[rows] for column in columns))


class Consensus(NamedTuple):
    """The motions that win in each of V views, N of each, the best first.

    ``worth`` (N, V) is what agrees with each, 0 where nothing corresponds, and ``motions`` has
    arrays (N, V), 0 there as well. ``motion_of_pair`` (M,) is the number of the motion that each
    correspondence agrees with, -1 if with none.
    """

    worth: NDArray[np.float32]
    motions: Motions
    motion_of_pair: NDArray[np.intp]


def find_motions(
    pairs: Correspondences,
    views: NDArray[np.intp],
    n_views: int,
    params: MatchingParams,
    n_motions: int = 1,
) -> Consensus:
    """Find the ``n_motions`` densest motions of each view, and fit each to the pairs that agree.

    Parameters
    ----------
    pairs
        M correspondences, in order of the query's contours, of which the longest come first.
    views
        (M,) of which view each is, in ``0 .. n_views - 1``.
    """
    sigma_yaw_rad = np.radians(params.sigma_yaw_deg)
    in_widths = np.stack(
        [
            pairs.yaw * np.float32(1 / sigma_yaw_rad),
            pairs.shift.real * np.float32(1 / params.sigma_m),
            pairs.shift.imag * np.float32(1 / params.sigma_m),
            pairs.height * np.float32(1 / params.sigma_height_m),
        ],
        axis=1,
    )
    worth = np.zeros((n_motions, n_views), np.float32)
    yaw, height = np.zeros(worth.shape), np.zeros(worth.shape)
    shift = np.zeros(worth.shape, np.complex128)
    motion_of_pair = np.full(len(views), -1)
    certainty = (1 / params.sigma_m**2, 1 / sigma_yaw_rad**2)
    found = (worth, yaw, shift, height, motion_of_pair)
    _find_motions(pairs, in_widths, np.argsort(views, kind="stable"), views, certainty, found)
    return Consensus(worth, Motions(yaw, shift, height), motion_of_pair)


@compiled
def _find_motions(
    pairs: Correspondences,
    in_widths: NDArray[np.float32],
    order: NDArray[np.intp],
    views: NDArray[np.intp],
    certainty: tuple[float, float],
    found: tuple[NDArray[Any], ...],
) -> None:
    """Fill in worth, yaw, shift, height (each (N, V)) and the motion of each pair (M,).

    ``in_widths`` (M, 4) are the pairs' motions in widths of the kernel, and ``order`` (M,) the
    pairs in order of their views. The yaw is the most likely by both the centroids (Kabsch 1976)
    and the pairs' own yaws, whose ``certainty`` are the inverse variances.
    """
    worth, yaw, shift, height, motion_of_pair = found
    left = np.empty_like(order)
    stop = 0
    while stop < len(order):
        start, view = stop, views[order[stop]]
        while stop < len(order) and views[order[stop]] == view:
            stop += 1
        n = stop - start
        left[:n] = order[start:stop]
        for motion in range(len(worth)):
            if n == 0:
                break
            winner = in_widths[_densest(in_widths, pairs.weight, left[:n])]
            total, up = 0.0, 0.0
            query_m = match_m = product = turn = 0j
            contour, best = -1, ZERO
            rest = 0
            for pair in left[:n]:
                agreement = _agreement(in_widths[pair], winner)
                counted = agreement * pairs.weight[pair]
                if pairs.query[pair] != contour:
                    worth[motion, view] += best
                    contour, best = pairs.query[pair], ZERO
                # Each contour of the query counts once, by its best partner.
                best = max(best, counted)
                if agreement > MIN_AGREEMENT:
                    motion_of_pair[pair] = motion
                    q, m = pairs.query_m[pair], pairs.match_m[pair]
                    total += counted
                    query_m += counted * q
                    match_m += counted * m
                    product += counted * np.conj(q) * m
                    turn += counted * pairs.turn[pair]
                    up += counted * pairs.height[pair]
                else:
                    left[rest] = pair
                    rest += 1
            worth[motion, view] += best
            n = rest
            if total > 0.0:
                query_m, match_m, product = query_m / total, match_m / total, product / total
                by_centroids = product - np.conj(query_m) * match_m
                together = certainty[0] * by_centroids + certainty[1] * turn / total
                yaw[motion, view] = np.angle(together)
                shift[motion, view] = match_m - together / abs(together) * query_m
                height[motion, view] = up / total


@compiled
def _densest(
    in_widths: NDArray[np.float32], weight: NDArray[np.float32], pairs: NDArray[np.intp]
) -> int:
    """Return which of the first pairs has the densest motion.

    The inner loop is over motions tried, so that it becomes vector instructions.
    """
    tried = np.empty((4, MAX_TRIED), np.float32)
    for k in range(MAX_TRIED):
        tried[:, k] = in_widths[pairs[min(k, len(pairs) - 1)]]
    yaws, xs, zs, heights = tried[0], tried[1], tried[2], tried[3]
    density = np.zeros(MAX_TRIED, np.float32)
    for pair in pairs:
        own, counted = in_widths[pair], weight[pair]
        yaw, x, z, height = own[0], own[1], own[2], own[3]
        for k in range(MAX_TRIED):
            a, b, c, d = yaws[k] - yaw, xs[k] - x, zs[k] - z, heights[k] - height
            near = max(ONE - (a * a + b * b + c * c + d * d) * PER_REACH2, ZERO)
            near *= near
            near *= near
            near *= near
            near *= near
            density[k] += counted * near * near
    return int(pairs[np.argmax(density)])


@compiled
def _agreement(a: NDArray[np.float32], b: NDArray[np.float32]) -> np.float32:
    """Return how far two motions agree, from 1 down to 0: exp(-d^2 / 2), and 0 far away.

    (1 - d^2 / 64)^32 is nearly that and takes multiplications only.
    """
    apart2 = ZERO
    for axis in range(4):
        apart2 += (a[axis] - b[axis]) * (a[axis] - b[axis])
    near = max(ONE - apart2 * PER_REACH2, ZERO)
    near *= near
    near *= near
    near *= near
    near *= near
    return np.float32(near * near)
