"""Consensus of BOF correspondences of one query with many views, all at once."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation_matching import Correspondences, MatchingParams, features

__all__ = ["Votes", "vote"]

WIDTHS = (4, 12, 24, 48)
"""Views with up to so many correspondences are computed together; of more, the heaviest vote."""
MAX_MOTIONS = 24
"""Correspondences of a view, the heaviest, whose motions are tried."""


class Votes(NamedTuple):
    """The motion that wins in each of V views.

    ``worth`` (V,) is what agrees with it; 0 where nothing corresponds. ``pairs`` are the
    correspondences in order of view (``views``, M), and ``agreement`` (M,) says how far each
    agrees, in [0, 1].
    """

    worth: NDArray[np.float32]
    pairs: Correspondences
    views: NDArray[np.intp]
    agreement: NDArray[np.float32]


def vote(
    pairs: Correspondences, views: NDArray[np.intp], n_views: int, params: MatchingParams
) -> Votes:
    """Find the densest motion of each view.

    Parameters
    ----------
    pairs
        M correspondences of the query.
    views
        (M,) of which view each is, in ``0 .. n_views - 1``.
    """
    order = np.lexsort((-pairs.weight, views))
    pairs, views = pairs.take(order), views[order]
    counts = np.bincount(views, minlength=n_views)
    starts = np.cumsum(counts) - counts
    at = features(pairs, params)
    winners = np.zeros(n_views, np.intp)
    for low, width in pairwise((0, *WIDTHS)):
        high = width if width < WIDTHS[-1] else len(views)
        some = np.flatnonzero((counts > low) & (counts <= high))
        if len(some):
            winners[some] = _densest(at, pairs.weight, starts[some], counts[some], width)
    offset = at - at[winners[views]]
    agreement = np.exp(np.float32(-0.5) * np.einsum("ij,ij->i", offset, offset))
    n_query = int(pairs.query.max(initial=-1)) + 1
    best = np.zeros(n_views * n_query, np.float32)
    np.maximum.at(best, views * n_query + pairs.query, agreement * pairs.weight)
    worth = best.reshape(n_views, n_query).sum(axis=1)
    return Votes(worth, pairs, views, agreement)


def _densest(
    at: NDArray[np.float32],
    weight: NDArray[np.float32],
    starts: NDArray[np.intp],
    counts: NDArray[np.intp],
    width: int,
) -> NDArray[np.intp]:
    """Return the row of the densest motion of each view (G,), of rows ``starts`` and on."""
    column = np.arange(width)
    rows = starts[:, None] + np.minimum(column, counts[:, None] - 1)
    points, voting = at[rows], weight[rows]
    voting[column >= counts[:, None]] = 0.0
    length2 = np.float32(-0.5) * np.einsum("gwk,gwk->gw", points, points)
    tried = points[:, :MAX_MOTIONS]
    exponent = tried @ points.transpose(0, 2, 1)
    exponent += length2[:, None]
    exponent += length2[:, :MAX_MOTIONS, None]
    np.minimum(exponent, np.float32(0.0), out=exponent)
    density = (np.exp(exponent, out=exponent) @ voting[:, :, None])[:, :, 0]
    return np.asarray(starts + density.argmax(axis=1))
