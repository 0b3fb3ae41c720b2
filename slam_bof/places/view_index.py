"""Views in the order in which they are searched, and what proposes that two show one place.

Two proposers: the constellation, whose contours vote for views and motions (``slam_bof.bof``), and
the range panorama. They miss different views: contours that the image's edge cuts change as the
camera turns, which the panorama hardly notices, and the panorama changes as the camera moves.
"""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof import ConstellationIndex, IndexParams, Motions, PlacedBofs
from slam_bof.core import GrowingArray
from slam_bof.places.range_panorama import Panorama
from slam_bof.types import Params

__all__ = ["Proposals", "ViewIndex", "ViewIndexParams"]


class ViewIndexParams(Params):
    """How many views each step looks at, and what the proposers count."""

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
    """Views that may show what a query does.

    ``scores`` (n,) are those of all asked, -1 of what was not compared. ``view_ids`` (m,) are the
    best, best first, and ``motions`` (m,) those of the query's levelled frame in theirs.
    """

    scores: NDArray[np.float32]
    view_ids: NDArray[np.intp]
    motions: Motions


class ViewIndex:
    """Holds what the two proposers know of each view."""

    def __init__(self, params: ViewIndexParams) -> None:
        self.params = params
        self._index = ConstellationIndex(params.index)
        self._panorama = Panorama()
        self._panoramas = GrowingArray((*self._panorama.shape, 2), np.int8)
        self._steps = GrowingArray((), np.float32)
        self._ids: list[int] = []

    @property
    def nbytes(self) -> int:
        """Bytes of all views held."""
        return self._index.nbytes + self._panoramas.rows.nbytes

    def add(self, view_id: int, bofs: PlacedBofs, points_level: NDArray[np.float32]) -> None:
        """Hold another view, whose id is above all before, with its points (N, 3)."""
        self._index.add(bofs)
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

    def around(self, view_id: int, n: int, below: int) -> list[int]:
        """Return the ids of a view and of ``n`` on either side that are searched, all < below."""
        at = bisect_left(self._ids, view_id)
        return self._ids[max(0, at - n) : min(at + n + 1, bisect_left(self._ids, below))]

    def propose(
        self, view_id: int, n_views: int, n: int, *, but: NDArray[np.integer[Any]] | None = None
    ) -> Proposals:
        """Return which of the views with ids below ``n_views``, ``but`` for some, are alike.

        The view that asks must be held; the best ``n`` are returned with their motions.
        """
        p = self.params
        ids = np.array(self._ids, np.intp)
        allowed = (ids < n_views) & ~np.isin(ids, [] if but is None else but)
        asking = bisect_left(self._ids, view_id)
        bofs = self._index.bofs(asking)
        if allowed.sum() > p.n_voted:
            rows = voted = self._index.candidates(bofs, p.n_voted, allowed=allowed)
        else:
            rows = np.flatnonzero(allowed)
            voted = self._index.candidates(bofs, p.n_compared, allowed=allowed)
        alike = self._alike(rows, asking)
        # Compared contour by contour: half by each proposer.
        voted = voted[: p.n_compared // 2]
        by_panorama = rows[np.argsort(-alike, kind="stable")[: p.n_compared - len(voted)]]
        found = self._index.compare(bofs, np.union1d(voted, by_panorama))
        scores = np.full(len(ids), -1.0, np.float32)
        scores[rows] = alike
        scores[found.view_ids] += np.float32(p.constellation_weight) * found.scores
        best = np.argsort(-scores[found.view_ids], kind="stable")[:n]
        of_all = np.full(max(n_views, 0), -1.0, np.float32)
        of_all[ids[rows]] = scores[rows]
        motions: tuple[NDArray[Any], ...] = found.motions
        return Proposals(
            of_all, ids[found.view_ids[best]], Motions(*(column[best] for column in motions))
        )

    def _alike(self, rows: NDArray[np.intp], asking: int) -> NDArray[np.float32]:
        """Return the correlation (n,) of the panoramas of rows (n,) with that of another."""
        packed, steps = self._panoramas.rows, self._steps.rows
        query = packed[asking].astype(np.float32).view(np.complex64)[..., 0] * steps[asking]
        return self._panorama.compare(packed[rows], steps[rows], query)
