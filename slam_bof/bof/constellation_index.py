"""An index of constellations: which views may agree with a query, without comparing all.

Contours are looked up by cells of slice, size and shape. Each that is found votes for a motion of
its view (``motion_votes``). Views in which many votes fall together are compared contour by
contour, and ranked by consensus (``constellation_consensus``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof.constellation import PlacedBofs
from slam_bof.bof.constellation_consensus import Motions, find_motions
from slam_bof.bof.constellation_correspondences import (
    MatchingParams,
    find_correspondences,
    weights,
)
from slam_bof.bof.constellation_packing import (
    PACKED,
    pack_constellation,
    packed_places,
    unpack_constellation,
)
from slam_bof.bof.indexed_view import IndexedView, index_view
from slam_bof.bof.levelled_slices import DEFAULT_SLICES
from slam_bof.bof.motion_votes import MAX_VIEWS, MotionVotes, count_votes, phases
from slam_bof.bof.posting_lists import PostingLists, Postings, join_postings
from slam_bof.bof.shape_cells import contour_keys, key_ranges
from slam_bof.core import GrowingArray
from slam_bof.types import Params

__all__ = ["ConstellationIndex", "IndexParams", "RankedViews"]

NO_NUMBERS = np.empty(0, np.int32)
NO_POSTINGS = Postings(NO_NUMBERS, NO_NUMBERS, NO_NUMBERS, np.empty((0, 2), np.uint8))


class IndexParams(Params):
    """How many views are compared contour by contour, and how."""

    n_compared: int = Field(
        50,
        gt=0,
        description="Number of views with most votes that are matched contour by contour.",
    )
    max_views_beside: int = Field(
        4000,
        ge=0,
        description="Largest number of views of a map in which contours are looked up in the "
        "slices beside their own as well.",
    )
    max_votes: int = Field(
        1_000_000,
        gt=0,
        description="Largest number of votes that are counted for a query; in a large map, its "
        "contours of the most common shapes do not vote.",
    )
    matching: MatchingParams = MatchingParams()


@dataclass(frozen=True, slots=True, eq=False)
class RankedViews:
    """Views that agree with a query, best first.

    Ids, scores and motions (n,) are of all that were compared. ``others`` are further motions of
    the same views, each the one on which most of the remaining correspondences agree.
    """

    view_ids: NDArray[np.intp]
    scores: NDArray[np.float32]
    motions: Motions
    others: tuple[Motions, ...] = ()

    def first(self, n: int) -> RankedViews:
        """Return the best ``n``, with one motion each."""
        return RankedViews(self.view_ids[:n], self.scores[:n], self.motions.take(slice(n)))


class ConstellationIndex:
    """Holds constellations, packed, and finds those that agree with another.

    Parameters
    ----------
    params
        How many views are compared, and how.
    slice_step_m
        Height from one slice to the next, by which all views and queries are described.

    Examples
    --------
    >>> index = ConstellationIndex()
    >>> for frame, gravity_camera in frames:  # doctest: +SKIP
    ...     index.add(describe_constellation(frame, gravity_camera).bofs)
    >>> index.find(query.bofs, 20).view_ids  # doctest: +SKIP
    """

    def __init__(
        self, params: IndexParams | None = None, *, slice_step_m: float = DEFAULT_SLICES.step_m
    ) -> None:
        self.params = params or IndexParams()
        self._slice_step_m = slice_step_m
        self._rows = GrowingArray((), PACKED)
        self._starts = GrowingArray((), np.int64)
        self._starts.append(0)
        self._totals = GrowingArray((), np.float32)
        self._postings = PostingLists()

    def __len__(self) -> int:
        """Return the number of views held."""
        return len(self._totals)

    @property
    def nbytes(self) -> int:
        """Bytes of all views held."""
        arrays = (self._rows, self._starts, self._totals)
        return self._postings.nbytes + sum(array.rows.nbytes for array in arrays)

    @classmethod
    def of(
        cls, bofs: PlacedBofs, counts: NDArray[np.integer[Any]], params: IndexParams | None = None
    ) -> Self:
        """Hold the contours of many views, which have ``counts`` (V,) contours each."""
        index, rows = cls(params), pack_constellation(bofs)
        views = np.repeat(np.arange(len(counts)), counts)
        totals = np.bincount(views, weights(bofs), len(counts)).astype(np.float32)
        keys, places = contour_keys(bofs, rows["mean"]), packed_places(rows)
        postings = Postings(keys, views.astype(np.int32), places, phases(bofs))
        index._hold(rows, np.append(0, np.cumsum(counts)), totals, postings.sorted())
        return index

    @classmethod
    def load(cls, columns: Mapping[str, NDArray[Any]], params: IndexParams | None = None) -> Self:
        """Hold what ``columns`` has returned; the arrays may be those of a file."""
        index = cls(params)
        postings = Postings(*(columns[name] for name in Postings._fields))
        index._hold(columns["rows"], columns["starts"], columns["totals"], postings)
        return index

    @classmethod
    def joined(cls, parts: Sequence[Self], params: IndexParams | None = None) -> Self:
        """Hold the views of several indices, one after another."""
        index = cls(params)
        rows, starts, postings, n_views, n_rows = [], [np.zeros(1, np.int64)], [], 0, 0
        for part in parts:
            rows.append(part._rows.rows)
            starts.append(part._starts.rows[1:] + n_rows)
            lists = part._postings.lists()
            postings += [p._replace(views=p.views + np.int32(n_views)) for p in lists]
            n_views, n_rows = n_views + len(part), n_rows + len(part._rows)
        totals = np.concatenate([part._totals.rows for part in parts])
        index._hold(np.concatenate(rows), np.concatenate(starts), totals, join_postings(postings))
        return index

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return all that is held, as arrays to be saved for ``load``."""
        postings = join_postings(self._postings.lists() or [NO_POSTINGS])
        return {
            "rows": self._rows.rows,
            "starts": self._starts.rows,
            "totals": self._totals.rows,
            **postings._asdict(),
        }

    def _hold(
        self,
        rows: NDArray[np.void],
        starts: NDArray[np.int64],
        totals: NDArray[np.float32],
        postings: Postings,
    ) -> None:
        """Hold arrays of views, in place of what was held."""
        self._rows, self._starts = GrowingArray.of(rows), GrowingArray.of(starts)
        self._totals, self._postings = GrowingArray.of(totals), PostingLists.of(postings)

    def add(self, bofs: PlacedBofs) -> int:
        """Hold another view, and return its id; see ``add_view``."""
        return self.add_view(index_view(bofs))

    def add_view(self, view: IndexedView) -> int:
        """Hold another view, and return its id: 0, 1, 2 ...

        Raises
        ------
        ValueError
            If it holds as many as it can.
        """
        view_id = len(self)
        if view_id >= MAX_VIEWS:
            raise ValueError(f"an index holds at most {MAX_VIEWS} views")
        self._rows.extend(view.rows)
        self._starts.append(len(self._rows))
        self._totals.append(view.total)
        ids = np.full(len(view), view_id, np.int32)
        self._postings.add(Postings(view.keys, ids, packed_places(view.rows), view.phases))
        return view_id

    def pop(self) -> None:
        """Drop the view added last; no more than two after another."""
        self._postings.pop()
        self._starts.truncate(len(self))
        self._rows.truncate(int(self._starts.rows[-1]))
        self._totals.truncate(len(self) - 1)

    def keep(self, is_kept: NDArray[np.bool_]) -> None:
        """Keep only the views where ``is_kept`` (V,) is true, and renumber them 0, 1, 2 ..."""
        counts = np.diff(self._starts.rows)
        self._rows.keep(np.repeat(is_kept, counts))
        self._totals.keep(is_kept)
        self._postings.keep(is_kept)
        self._starts.truncate(1)
        self._starts.extend(np.cumsum(counts[is_kept]))

    def bofs(self, view_id: int) -> PlacedBofs:
        """Return the contours of a view, as they are kept."""
        return unpack_constellation(
            self._rows.rows[self._starts.rows[view_id] : self._starts.rows[view_id + 1]]
        )

    def find(
        self, query: PlacedBofs, n: int, *, allowed: NDArray[np.bool_] | None = None
    ) -> RankedViews:
        """Return the up to ``n`` views that agree best with a query.

        ``allowed`` (V,) leaves some out.
        """
        views = self.candidates(query, self.params.n_compared, allowed=allowed)
        return self.compare(query, views).first(n)

    def candidates(
        self, query: PlacedBofs, n: int, *, allowed: NDArray[np.bool_] | None = None
    ) -> NDArray[np.intp]:
        """Return the up to ``n`` views (m,) that have most votes for one motion, best first."""
        return self.vote(query, n, allowed=allowed)[0]

    def vote(
        self, query: PlacedBofs, n: int, *, allowed: NDArray[np.bool_] | None = None
    ) -> tuple[NDArray[np.intp], NDArray[np.float32]]:
        """Return the same, and what the votes (m,) for each are worth."""
        voters = MotionVotes(query)
        is_small = len(self) <= self.params.max_views_beside
        apart = self.params.matching.max_slices if is_small else 0
        contours, low, high = key_ranges(query, range(-apart, apart + 1))
        lists = self._postings.lists()
        begins = [np.searchsorted(postings.keys, low) for postings in lists]
        counts = [
            np.searchsorted(postings.keys, high) - begin
            for postings, begin in zip(lists, begins, strict=True)
        ]
        n_found = np.sum(counts, axis=0) if lists else np.zeros(len(low))
        kept = self._rarest(contours, n_found, len(query.slices))
        cells = [np.empty(0, np.uint32)]
        cells += [
            voters.cells(contours[kept], begin[kept], count[kept], postings)
            for postings, begin, count in zip(lists, begins, counts, strict=True)
        ]
        return count_votes(np.concatenate(cells), self._totals.rows, n, allowed)

    def _rarest(
        self, contours: NDArray[np.intp], n_found: NDArray[Any], n_contours: int
    ) -> NDArray[np.bool_]:
        """Return which ranges (R,) to look up: those of contours with the rarest shapes."""
        of_contours = np.bincount(contours, n_found, n_contours)
        order = np.argsort(of_contours, kind="stable")
        asked = np.zeros(n_contours, np.bool_)
        asked[order[np.cumsum(of_contours[order]) <= self.params.max_votes]] = True
        return np.asarray(asked[contours])

    def compare(
        self, query: PlacedBofs, views: NDArray[np.intp], n_motions: int = 1
    ) -> RankedViews:
        """Rank views (n,) by consensus of all their contours, with ``n_motions`` of each."""
        p = self.params.matching
        starts, stops = self._starts.rows[views], self._starts.rows[views + 1]
        counts = stops - starts
        which = np.repeat(np.arange(len(views)), counts)
        rows = np.arange(len(which)) + np.repeat(starts - (np.cumsum(counts) - counts), counts)
        bofs = unpack_constellation(self._rows.rows.take(rows))
        pairs = find_correspondences(query, bofs, p, self._slice_step_m)
        found = find_motions(pairs, which[pairs.match], len(views), p, n_motions)
        total = np.sqrt(weights(query).sum() * self._totals.rows[views])
        scores = found.worth[0] / np.maximum(total, np.float32(1e-6))
        best = np.argsort(-scores, kind="stable")
        columns: tuple[NDArray[Any], ...] = found.motions
        motions, *others = (
            Motions(*(column[motion, best] for column in columns)) for motion in range(n_motions)
        )
        return RankedViews(views[best], scores[best], motions, tuple(others))
