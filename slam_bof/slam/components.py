"""Connected components of the pose graph: track segments that are joined by loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray

__all__ = ["CULLED", "MapComponents"]

CULLED = -1
"""Component of culled keyframes in the list of those in use."""


class MapComponents:
    """The component of each keyframe.

    Relative poses of keyframes are known within a component. Between components they are unknown,
    because odometry was lost there and no loop has joined the two yet.

    >>> components = MapComponents()
    >>> for segment in (0, 0, 1, 1, 2):
    ...     components.add(segment)
    >>> components.join(0, 4)
    >>> components.of_keyframes().tolist()
    [0, 0, 1, 1, 0]
    """

    def __init__(self) -> None:
        self._of_segment: dict[int, int] = {}
        self._of_keyframe = GrowingArray((), np.int64)
        self._in_use = GrowingArray((), np.int64)

    def __len__(self) -> int:
        """Return the number of components."""
        return len(set(self._of_segment.values()))

    def add(self, segment: int) -> None:
        """Add the next keyframe, given its segment."""
        component = self._of_segment.setdefault(segment, segment)
        self._of_keyframe.append(component)
        self._in_use.append(component)

    def join(self, keyframe_id: int, other_id: int) -> None:
        """Join the components of two keyframes."""
        rows = self._of_keyframe.rows
        older, younger = sorted((int(rows[keyframe_id]), int(rows[other_id])))
        if older == younger:
            return
        for components in (self._of_keyframe, self._in_use):
            components.put(components.rows == younger, older)
        for segment, component in self._of_segment.items():
            if component == younger:
                self._of_segment[segment] = older

    def cull(self, keyframe_ids: list[int]) -> None:
        """Mark keyframes as culled."""
        self._in_use.put(keyframe_ids, CULLED)

    def of_keyframes(self) -> NDArray[np.int64]:
        """Return the component (K,) of each keyframe, named by the first of its segments."""
        return self._of_keyframe.rows

    def in_use(self) -> NDArray[np.int64]:
        """Return the same, but ``CULLED`` for keyframes that were culled."""
        return self._in_use.rows
