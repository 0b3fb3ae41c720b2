"""The motion that most BOF correspondences of a query with each of many views agree on.

A random sample of RANSAC (Fischler and Bolles 1981) needs one correspondence only, for that is a
whole motion; so all are tried, the one that most others agree with wins, and the motion is fitted
to those that do.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation_correspondences import Correspondences, MatchingParams
from slam_bof.core import compiled

__all__ = ["Motions", "Votes", "fit_motions", "vote"]

MAX_MOTIONS = 24
"""Correspondences of a view, the first, whose motions are tried."""
MAX_APART2 = np.float32(20.0)
"""Motions farther apart than this, squared and in widths of the kernel, do not agree at all."""

MIN_AGREEMENT = 0.1
"""By the kernel, of an inlier."""


class Votes(NamedTuple):
    """The motion that wins in each of V views.

    ``worth`` (V,) is what agrees with it; 0 where nothing corresponds. ``pairs`` are the
    correspondences in order of view (``views``, M) and contour of the query, and ``agreement``
    (M,) says how far each agrees, in [0, 1].
    """

    worth: NDArray[np.float32]
    pairs: Correspondences
    views: NDArray[np.intp]
    agreement: NDArray[np.float32]

    def disagreeing(self) -> tuple[Correspondences, NDArray[np.intp]]:
        """Return the correspondences that do not agree, and the view of each."""
        rows = np.flatnonzero(self.agreement <= MIN_AGREEMENT)
        return self.pairs.take(rows), self.views.take(rows)


def vote(
    pairs: Correspondences, views: NDArray[np.intp], n_views: int, params: MatchingParams
) -> Votes:
    """Find the densest motion of each view.

    Parameters
    ----------
    pairs
        M correspondences, in order of the query's contours, of which the longest come first.
    views
        (M,) of which view each is, in ``0 .. n_views - 1``.
    """
    order = np.argsort(views, kind="stable")
    pairs, views = pairs.take(order), views.take(order)
    counts = np.bincount(views, minlength=n_views)
    starts = np.cumsum(counts) - counts
    at = features(pairs, params)
    winners = _densest(at, pairs.weight, starts, counts)
    offset = at - at.take(winners.take(views), axis=0)
    agreement = np.exp(np.float32(-0.5) * np.einsum("ij,ij->i", offset, offset))
    # Each contour of the query counts once, by its best partner.
    first = np.flatnonzero(
        (np.diff(views, prepend=-1) != 0) | (np.diff(pairs.query, prepend=-1) != 0)
    )
    best = np.maximum.reduceat(agreement * pairs.weight, first) if len(first) else agreement
    worth = np.bincount(views[first], best, n_views).astype(np.float32)
    return Votes(worth, pairs, views, agreement)


class Motions(NamedTuple):
    """Of the query's levelled frame in those of V views: ``x + i z`` and height in metres."""

    yaw: NDArray[np.float64]
    shift: NDArray[np.complex128]
    height: NDArray[np.float64]

    def take(self, rows: NDArray[np.integer[Any]] | slice) -> Motions:
        """Return some rows."""
        columns: tuple[NDArray[Any], ...] = self
        return Motions(*(column[rows] for column in columns))


def fit_motions(votes: Votes, chosen: NDArray[np.intp], params: MatchingParams) -> Motions:
    """Fit the motion of each chosen view (V,) to the pairs that agree; 0 where there are none.

    The yaw is the most likely by both the centroids (Kabsch 1976) and the pairs' own yaws.
    """
    n_views = len(chosen)
    number = np.full(len(votes.worth), -1)
    number[chosen] = np.arange(n_views)
    rows = np.flatnonzero((votes.agreement > MIN_AGREEMENT) & (number[votes.views] >= 0))
    pairs, views = votes.pairs.take(rows), number[votes.views[rows]]
    weight = votes.agreement[rows] * pairs.weight
    total = _sums(weight, views, n_views)
    weight = weight / np.where(total > 0, total, 1.0)[views]
    query_mean = _sums(weight * pairs.query_m, views, n_views)
    match_mean = _sums(weight * pairs.match_m, views, n_views)
    query_off, match_off = pairs.query_m - query_mean[views], pairs.match_m - match_mean[views]
    by_centroids = _sums(weight * query_off.conj() * match_off, views, n_views)
    by_yaws = _sums(weight * np.exp(1j * pairs.yaw), views, n_views)
    yaw = np.angle(
        by_centroids / params.sigma_m**2 + by_yaws / np.radians(params.sigma_yaw_deg) ** 2
    )
    shift = match_mean - np.exp(1j * yaw) * query_mean
    return Motions(yaw, shift, _sums(weight * pairs.height, views, n_views))


def features(pairs: Correspondences, params: MatchingParams) -> NDArray[np.float32]:
    """Return motions (M, 4) in units of the kernel."""
    return np.stack(
        [
            pairs.yaw * np.float32(1 / np.radians(params.sigma_yaw_deg)),
            pairs.shift.real * np.float32(1 / params.sigma_m),
            pairs.shift.imag * np.float32(1 / params.sigma_m),
            pairs.height * np.float32(1 / params.sigma_height_m),
        ],
        axis=1,
    )


def _sums(values: NDArray[Any], views: NDArray[np.intp], n_views: int) -> NDArray[Any]:
    """Add up values (M,) by view, (V,)."""
    if np.iscomplexobj(values):
        return _sums(values.real, views, n_views) + 1j * _sums(values.imag, views, n_views)
    return np.bincount(views, values, n_views)


@compiled
def _densest(
    at: NDArray[np.float32],
    weight: NDArray[np.float32],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
) -> NDArray[np.intp]:
    """Return the row of the densest motion of each view (V,), with rows ``starts`` and on."""
    winners = np.zeros(len(starts), np.intp)
    half = np.float32(-0.5)
    for view in range(len(starts)):
        first, stop = starts[view], starts[view] + counts[view]
        highest = np.float32(-1.0)
        for tried in range(first, min(stop, first + MAX_MOTIONS)):
            density = np.float32(0.0)
            for row in range(first, stop):
                apart2 = np.float32(0.0)
                for axis in range(at.shape[1]):
                    apart = at[row, axis] - at[tried, axis]
                    apart2 += apart * apart
                if apart2 < MAX_APART2:
                    density += weight[row] * np.exp(half * apart2)
            if density > highest:
                highest, winners[view] = density, tried
    return winners
