"""Which keyframes hang together: segments of an uninterrupted track, joined to parts by loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

__all__ = ["MapParts"]


class MapParts:
    """Knows of each keyframe which part of the map it is in.

    Within a part, poses say where keyframes are from each other. Between parts they say nothing:
    odometry was lost there, and no loop has joined the two yet.

    >>> parts = MapParts()
    >>> for segment in (0, 0, 1, 1, 2):
    ...     parts.add(segment)
    >>> parts.join(0, 4)
    >>> parts.of_keyframes().tolist()
    [0, 0, 1, 1, 0]
    """

    def __init__(self) -> None:
        self._segments: list[int] = []
        self._joined: DisjointSet = DisjointSet()

    def __len__(self) -> int:
        """Return the number of parts."""
        return int(self._joined.n_subsets)

    def add(self, segment: int) -> None:
        """Take the segment of the next keyframe."""
        self._segments.append(segment)
        self._joined.add(segment)

    def join(self, keyframe_id: int, other_id: int) -> None:
        """Make one part of those that two keyframes are in."""
        self._joined.merge(self._segments[keyframe_id], self._segments[other_id])

    def of_keyframes(self) -> NDArray[np.int64]:
        """Return each keyframe's part (K,), called by the first of its segments."""
        part = {segment: min(self._joined.subset(segment)) for segment in self._joined}
        return np.array([part[segment] for segment in self._segments], dtype=np.int64)
