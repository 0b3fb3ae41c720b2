"""An inverted index over bags of words: which frames share words, and how much."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray
from slam_bof.types import Bag

__all__ = ["InvertedIndex"]


class InvertedIndex:
    """Holds bags, and scores them all against a query.

    The score is the paper's (section 3.4), ``s(a, b) = 1 - |a - b|_1 / 2``, which for bags
    that sum to 1 is ``sum_i min(a_i, b_i)``: only words that both hold count. An empty bag
    scores 0 against all.

    Parameters
    ----------
    n_words
        Words of the vocabulary.
    """

    def __init__(self, n_words: int) -> None:
        self.n_words = n_words
        self._n_bags = 0
        self._postings: dict[int, _Postings] = {}

    def __len__(self) -> int:
        """Return the number of bags held."""
        return self._n_bags

    def add(self, bag: Bag) -> int:
        """Hold another bag, and return its id: 0, 1, 2 ..."""
        self._check(bag)
        bag_id = self._n_bags
        for word, weight in zip(bag.words.tolist(), bag.weights.tolist(), strict=True):
            postings = self._postings.get(word)
            if postings is None:
                postings = self._postings[word] = _Postings()
            postings.append(bag_id, weight)
        self._n_bags += 1
        return bag_id

    def scores(self, bag: Bag) -> NDArray[np.float32]:
        """Return the scores (n,) of all bags held, by id, each in [0, 1]."""
        self._check(bag)
        scores = np.zeros(self._n_bags, np.float32)
        for word, weight in zip(bag.words.tolist(), bag.weights, strict=True):
            postings = self._postings.get(word)
            if postings is not None:
                # This way to scatter takes 32-bit ids without a conversion.
                np.add.at(scores, postings.ids.rows, np.minimum(postings.weights.rows, weight))
        return np.minimum(scores, np.float32(1.0), out=scores)

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays held, with the room they have to grow."""
        return sum(postings.nbytes for postings in self._postings.values())

    def _check(self, bag: Bag) -> None:
        if len(bag.words) and not 0 <= bag.words[0] <= bag.words[-1] < self.n_words:
            raise ValueError(
                f"words must be in 0 .. {self.n_words - 1}, got {bag.words[0]} .. {bag.words[-1]}"
            )


class _Postings:
    """The bags that hold a word, and the weight it has in each."""

    __slots__ = ("ids", "weights")

    def __init__(self) -> None:
        self.ids = GrowingArray((), np.int32)
        self.weights = GrowingArray((), np.float32)

    def append(self, bag_id: int, weight: float) -> None:
        self.ids.append(bag_id)
        self.weights.append(weight)

    @property
    def nbytes(self) -> int:
        return self.ids.nbytes + self.weights.nbytes
