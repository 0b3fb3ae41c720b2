"""Shortest paths in the pose graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from slam_bof.types import Array

__all__ = ["Links"]

MIN_LENGTH = 1e-12
"""Length that a shorter link is given: in a sparse matrix, a link of length 0 would be none."""


class Links:
    """Links of some length between nodes 0, 1, ... ``n``; each leads both ways.

    Parameters
    ----------
    starts, stops, lengths
        (L,) the nodes that each link connects, and its length. Of several from one node to another
        the shortest counts.
    """

    def __init__(
        self, starts: NDArray[np.int64], stops: NDArray[np.int64], lengths: Array, n: int
    ) -> None:
        order = np.argsort(lengths, kind="stable")
        # csr_array would add up several links between two nodes.
        self._keys, first = np.unique((n * starts + stops)[order], return_index=True)
        self._chosen = order[first]
        self._lengths, self._n = lengths, n
        links = (np.maximum(lengths, MIN_LENGTH)[self._chosen], np.divmod(self._keys, n))
        self._matrix = csr_array(links, (n, n))

    def paths_from(self, root: int) -> tuple[Array, NDArray[np.int32]]:
        """Return the length (n,) of the shortest path to each node, and the node before it (n,).

        Where no path leads, the length is infinite and the node before negative.
        """
        lengths, before = dijkstra(
            self._matrix, directed=False, indices=root, return_predecessors=True
        )
        return np.asarray(lengths), np.asarray(before)

    def between(self, a: int, b: int) -> int:
        """Return the number of the shortest link between two nodes that have one."""
        keys = np.array([self._n * a + b, self._n * b + a])
        at = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        found = self._chosen[at[self._keys[at] == keys]]
        return int(found[np.argmin(self._lengths[found])])
