"""The search index of views, which proposes pairs of views of the same place.

It combines two methods: the constellation, whose contours vote for views and relative poses
(``slam_bof.bof``), and the range panorama. They fail in different cases. Contours that are cut by
the border of the image change when the camera turns, which hardly affects the panorama; the
panorama changes when the camera translates.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection
from dataclasses import dataclass
from itertools import compress
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof import ConstellationIndex, IndexedView, IndexParams, Motions
from slam_bof.core import GrowingArray
from slam_bof.places.range_panorama import Panorama
from slam_bof.types import Params

__all__ = ["Proposals", "ViewIndex", "ViewIndexParams"]


class ViewIndexParams(Params):
    """Sizes of the shortlists of the search, and weights of its two scores."""

    by: Literal["both", "constellation", "panorama"] = Field(
        "both",
        description="What proposes views: the constellation of BOFs, the range panorama, or both.",
    )
    n_voted: int = Field(
        200,
        gt=0,
        description="Number of views with most votes whose panoramas are compared.",
    )
    n_compared: int = Field(
        50,
        gt=0,
        description="Number of these that are matched contour by contour.",
    )
    constellation_weight: float = Field(
        3.0,
        ge=0,
        description="Weight of the constellation score beside that of the panorama, which is 1.",
    )
    index: IndexParams = IndexParams()


@dataclass(frozen=True, slots=True, eq=False)
class Proposals:
    """Views that may show the same place as a query.

    ``scores`` (n,) are those of all views searched, -1 for those that were not compared.
    ``view_ids`` (m,) are the best, best first. ``motions`` (m,) are the poses of the levelled frame
    of the query in theirs.
    """

    scores: NDArray[np.float32]
    view_ids: NDArray[np.intp]
    motions: Motions


class ViewIndex:
    """Stores the constellation and the range panorama of each view."""

    def __init__(self, params: ViewIndexParams) -> None:
        self.params = params
        self._index = ConstellationIndex(params.index)
        self._panorama = Panorama()
        self._panoramas = GrowingArray((*self._panorama.shape, 2), np.int8)
        self._steps = GrowingArray((), np.float32)
        self._ids: list[int] = []

    @property
    def nbytes(self) -> int:
        """Size of all stored views in bytes."""
        return self._index.nbytes + self._panoramas.rows.nbytes

    def add(self, view_id: int, view: IndexedView, points_level: NDArray[np.float32]) -> None:
        """Add a view with its levelled points (N, 3). Ids must increase."""
        self._index.add_view(view)
        packed, step = self._panorama.pack(self._panorama.spectrum(points_level))
        self._panoramas.append(packed)
        self._steps.append(step)
        self._ids.append(view_id)

    def pop(self) -> None:
        """Drop the view added last."""
        self._ids.pop()
        self._index.pop()
        self._panoramas.truncate(len(self._ids))
        self._steps.truncate(len(self._ids))

    def remove(self, view_ids: Collection[int]) -> None:
        """Remove views; those that the index does not have are ignored."""
        is_kept = ~np.isin(self._ids, list(view_ids))
        self._index.keep(is_kept)
        self._panoramas.keep(is_kept)
        self._steps.keep(is_kept)
        self._ids = list(compress(self._ids, is_kept))

    def neighbours(self, view_id: int, n: int, below: int) -> list[int]:
        """Return the ids of a view and of ``n`` stored views before and after it, all < below."""
        at = bisect_left(self._ids, view_id)
        return self._ids[max(0, at - n) : min(at + n + 1, bisect_left(self._ids, below))]

    def propose(
        self, view_id: int, n_views: int, n: int, *, exclude: NDArray[np.integer[Any]] | None = None
    ) -> Proposals:
        """Search the views with ids below ``n_views``, without those in ``exclude``.

        The query must be a stored view. The best ``n`` are returned with their motions.
        """
        p = self.params
        ids = np.array(self._ids, np.intp)
        allowed = (ids < n_views) & ~np.isin(ids, [] if exclude is None else exclude)
        query_row = bisect_left(self._ids, view_id)
        bofs = self._index.bofs(query_row)
        rows, voted = np.flatnonzero(allowed), np.empty(0, np.intp)
        if p.by != "panorama":
            crowded = len(rows) > p.n_voted
            n_voted = p.n_voted if crowded else p.n_compared
            voted = self._index.candidates(bofs, n_voted, allowed=allowed)
            rows = voted if crowded else rows
        panorama_scores = np.zeros(len(rows), np.float32)
        if p.by != "constellation":
            panorama_scores = self._panorama_scores(rows, query_row)
            # Of the views that are compared contour by contour, each method proposes half.
            voted = voted[: p.n_compared // 2]
            best = np.argsort(-panorama_scores, kind="stable")[: p.n_compared - len(voted)]
            voted = np.union1d(voted, rows[best])
        found = self._index.compare(bofs, voted)
        if p.by == "panorama":
            found = found.without_motion()
        scores = np.full(len(ids), -1.0, np.float32)
        scores[rows] = panorama_scores
        scores[found.view_ids] += np.float32(p.constellation_weight) * found.scores
        best = np.argsort(-scores[found.view_ids], kind="stable")[:n]
        scores_by_id = np.full(max(n_views, 0), -1.0, np.float32)
        scores_by_id[ids[rows]] = scores[rows]
        motions: tuple[NDArray[Any], ...] = found.motions
        return Proposals(
            scores_by_id, ids[found.view_ids[best]], Motions(*(column[best] for column in motions))
        )

    def _panorama_scores(self, rows: NDArray[np.intp], query_row: int) -> NDArray[np.float32]:
        """Return the correlation (n,) of the panoramas in rows (n,) with that of the query."""
        packed, steps = self._panoramas.rows, self._steps.rows
        query = packed[query_row].astype(np.float32).view(np.complex64)[..., 0] * steps[query_row]
        return self._panorama.compare(packed[rows], steps[rows], query)
