"""The search index of views, which proposes pairs of views of the same place.

It holds the constellations of views (``slam_bof.bof``) by their ids. Contours vote for views, and
those that correspond give several relative poses of each.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection
from itertools import compress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import ConstellationIndex, ConstellationParams, IndexedView, IndexParams, Motions

__all__ = ["Proposals", "ViewIndex"]

TURNS_RAD = np.radians([-12.0, 0.0, 12.0])
"""Turns on the spot that are proposed for each view as well: where walls fill the image, its border
cuts their contours, and what is left of them in two views need not correspond."""


class Proposals(NamedTuple):
    """Poses at which views may show the same place as a query.

    A view has several, one after another: ``view_ids`` (n,) are repeated. ``motions`` (n,) are the
    poses of the levelled frame of the query in those of the views.
    """

    view_ids: NDArray[np.intp]
    motions: Motions


class ViewIndex:
    """Stores the constellation of each view.

    Parameters
    ----------
    params
        How many views are compared, and how.
    described_by
        Parameters by which the views are described.
    """

    def __init__(self, params: IndexParams, described_by: ConstellationParams) -> None:
        self._index = ConstellationIndex(params, slice_step_m=described_by.slices.step_m)
        self._ids: list[int] = []

    @property
    def nbytes(self) -> int:
        """Size of all stored views in bytes."""
        return self._index.nbytes

    def add(self, view_id: int, view: IndexedView) -> None:
        """Add a view. Ids must increase."""
        self._index.add_view(view)
        self._ids.append(view_id)

    def pop(self) -> None:
        """Drop the view added last."""
        self._ids.pop()
        self._index.pop()

    def remove(self, view_ids: Collection[int]) -> None:
        """Remove views; those that the index does not have are ignored."""
        is_kept = ~np.isin(self._ids, list(view_ids))
        self._index.keep(is_kept)
        self._ids = list(compress(self._ids, is_kept))

    def neighbours(self, view_id: int, n: int, below: int) -> list[int]:
        """Return the ids of a view and of ``n`` stored views before and after it, all < below."""
        at = bisect_left(self._ids, view_id)
        return self._ids[max(0, at - n) : min(at + n + 1, bisect_left(self._ids, below))]

    def propose(
        self, view_id: int, n_views: int, *, exclude: NDArray[np.integer[Any]] | None = None
    ) -> Proposals:
        """Search the views with ids below ``n_views``, without those in ``exclude``.

        The query must be a stored view.
        """
        ids = np.array(self._ids, np.intp)
        allowed = (ids < n_views) & ~np.isin(ids, [] if exclude is None else exclude)
        index, p = self._index, self._index.params
        query = index.bofs(bisect_left(self._ids, view_id))
        voted = np.flatnonzero(allowed)
        if len(voted) > p.n_compared:
            voted = index.candidates(query, p.n_compared, allowed=allowed)
        found = index.compare(query, voted, p.matching.max_hypotheses)
        turns = [_turns(yaw, len(voted)) for yaw in TURNS_RAD]
        motions = [found.motions, *found.others, *turns]
        columns: zip[tuple[NDArray[Any], ...]] = zip(*motions, strict=True)
        return Proposals(
            np.repeat(ids[found.view_ids], len(motions)),
            Motions(*(np.stack(column, axis=1).reshape(-1) for column in columns)),
        )


def _turns(yaw: float, n: int) -> Motions:
    """Return ``n`` turns on the spot."""
    return Motions(np.full(n, yaw), np.zeros(n, np.complex128), np.zeros(n))
