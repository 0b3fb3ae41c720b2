"""Lists of contours by what they look like, sorted so that a range of one key is a slice.

Like the levels of a log-structured merge tree (O'Neil et al. 1996): contours are added to a short
list, and lists of about one length are merged, so that n contours are in some log n lists.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

__all__ = ["PostingLists", "Postings", "join_postings"]

MERGE_RATIO = 4
"""A list is merged with the one before it, unless that is at least this many times as long."""


class Postings(NamedTuple):
    """P contours: their key, their view, and what else a vote needs.

    ``places`` are centroids in steps, x in the lower 16 bits and z in the upper ones; ``phases``
    (P, 2) are those of two harmonics, 256 to the circle.
    """

    keys: NDArray[np.int32]
    views: NDArray[np.int32]
    places: NDArray[np.int32]
    phases: NDArray[np.uint8]

    def sorted(self) -> Postings:
        """Return the same in order of keys."""
        order = np.argsort(self.keys, kind="stable")
        columns: tuple[NDArray[Any], ...] = self
        return Postings(*(column[order] for column in columns))

    @property
    def nbytes(self) -> int:
        """Bytes of all columns."""
        return sum(column.nbytes for column in self)


class PostingLists:
    """Sorted lists, longest first, and the newest views' unsorted contours."""

    def __init__(self, n_new: int = 64) -> None:
        self._n_new = n_new
        self._lists: list[Postings] = []
        self._new: list[Postings] = []
        self._newest: Postings | None = None

    @classmethod
    def of(cls, postings: Postings) -> Self:
        """Hold postings that are sorted."""
        lists = cls()
        lists._lists.append(postings)
        return lists

    def add(self, postings: Postings) -> None:
        """Add a view's contours."""
        if len(self._new) > self._n_new:
            # The last may still be dropped.
            self._lists.append(_join(self._new[:-1]).sorted())
            self._new = self._new[-1:]
            while len(self._lists) > 1 and len(self._lists[-2].keys) < MERGE_RATIO * len(
                self._lists[-1].keys
            ):
                last = self._lists.pop()
                self._lists[-1] = _join([self._lists[-1], last]).sorted()
        self._new.append(postings)
        self._newest = None

    def pop(self) -> None:
        """Drop the contours of the view added last; of the last two, but of no more.

        Raises
        ------
        IndexError
            If there are none that can be dropped.
        """
        self._new.pop()
        self._newest = None

    def keep(self, is_kept: NDArray[np.bool_]) -> None:
        """Keep only the views where ``is_kept`` (V,) is true, and renumber them 0, 1, 2 ..."""
        numbers = (np.cumsum(is_kept) - 1).astype(np.int32)
        self._lists = [_chosen(postings, is_kept, numbers) for postings in self._lists]
        # Of a view that goes, an empty entry stays, so that ``pop`` still drops the newest view.
        self._new = [_chosen(postings, is_kept, numbers) for postings in self._new]
        self._newest = None

    def lists(self) -> list[Postings]:
        """Return all contours in lists that are sorted."""
        if self._newest is None:
            self._newest = _join(self._new).sorted() if self._new else None
        return self._lists + ([] if self._newest is None else [self._newest])

    @property
    def nbytes(self) -> int:
        """Bytes of all lists."""
        return sum(postings.nbytes for postings in self.lists())


def join_postings(parts: Sequence[Postings]) -> Postings:
    """Return the postings of several lists in order of keys."""
    return _join(parts).sorted()


def _chosen(postings: Postings, is_kept: NDArray[np.bool_], numbers: NDArray[np.int32]) -> Postings:
    """Return the contours of the views that are kept, with their new numbers."""
    inside = is_kept[postings.views]
    columns: tuple[NDArray[Any], ...] = postings
    chosen = Postings(*(column[inside] for column in columns))
    return chosen._replace(views=numbers[chosen.views])


def _join(postings: Sequence[Postings]) -> Postings:
    return Postings(*(np.concatenate(column) for column in zip(*postings, strict=True)))
