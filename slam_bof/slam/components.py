"""Connected components of the pose graph: track segments that loops have joined."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import DisjointSet

__all__ = ["MapComponents"]


class MapComponents:
    """The component of each keyframe.

    Within a component, the relative poses of keyframes are known. Between components they are
    not: odometry was lost there, and no loop has joined the two yet.

    >>> components = MapComponents()
    >>> for segment in (0, 0, 1, 1, 2):
    ...     components.add(segment)
    >>> components.join(0, 4)
    >>> components.of_keyframes().tolist()
    [0, 0, 1, 1, 0]
    """

    def __init__(self) -> None:
        self._segments: list[int] = []
        self._joined: DisjointSet = DisjointSet()

    def __len__(self) -> int:
        """Return the number of components."""
        return int(self._joined.n_subsets)

    def add(self, segment: int) -> None:
        """Take the segment of the next keyframe."""
        self._segments.append(segment)
        self._joined.add(segment)

    def join(self, keyframe_id: int, other_id: int) -> None:
        """Make one component of those that two keyframes are in."""
        self._joined.merge(self._segments[keyframe_id], self._segments[other_id])

    def of_keyframes(self) -> NDArray[np.int64]:
        """Return each keyframe's component (K,), called by the first of its segments."""
        component = {segment: min(self._joined.subset(segment)) for segment in self._joined}
        return np.array([component[segment] for segment in self._segments], dtype=np.int64)
