"""The matches of the last query, propagated by odometry to propose views for the next one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray
from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["FollowedMatches"]


class FollowedMatches:
    """Stores the odometry poses of all views, and the views that the last query matched."""

    def __init__(self) -> None:
        self._T_odom_camera = GrowingArray((4, 4), np.float64)
        self._last_id = 0
        self._matches: list[tuple[int, Pose]] = []

    def add(self, T_odom_camera: Pose) -> None:
        """Add the odometry pose of the next view."""
        self._T_odom_camera.append(T_odom_camera)

    def truncate(self, n: int) -> None:
        """Keep only the poses of the first ``n`` views."""
        self._T_odom_camera.truncate(n)

    def follow(self, view_id: int, matches: list[tuple[int, Pose]]) -> None:
        """Follow the matches of a view: the id of each and ``T_match_query``."""
        self._last_id, self._matches = view_id, matches

    def propose(
        self, view_id: int, neighbours: Callable[[int], list[int]]
    ) -> tuple[NDArray[np.intp], Array]:
        """Return the views (n,) around the followed matches, and ``T_neighbour_query`` (n, 4, 4).

        ``neighbours`` returns the ids of the views around a match. A view around several matches
        gets the pose from the first of them.
        """
        T_odom_camera = self._T_odom_camera.rows
        T_last_query = se3.inverse(T_odom_camera[self._last_id]) @ T_odom_camera[view_id]
        match_of: dict[int, int] = {}
        for match, (match_id, _) in enumerate(self._matches):
            for near in neighbours(match_id):
                match_of.setdefault(near, match)
        if not match_of:
            return np.empty(0, np.intp), np.empty((0, 4, 4))
        match_ids, T_match_last = zip(*self._matches, strict=True)
        T_odom_query = T_odom_camera[list(match_ids)] @ (np.array(T_match_last) @ T_last_query)
        near_ids = np.array(list(match_of), np.intp)
        T_near_odom = se3.inverse(T_odom_camera[near_ids])
        return near_ids, T_near_odom @ T_odom_query[list(match_of.values())]

    def state(self) -> list[Any]:
        """Return the followed matches as JSON values."""
        return [self._last_id, [[match_id, T.tolist()] for match_id, T in self._matches]]

    def restore(self, state: list[Any]) -> None:
        """Restore the followed matches from ``state``."""
        self._last_id = state[0]
        self._matches = [(match_id, np.array(T)) for match_id, T in state[1]]
