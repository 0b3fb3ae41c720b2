"""When loops may join two parts of the map, of which nothing says how they lie.

Drift cannot judge such a loop, and one that is wrong, two halls alike, lays whole rooms on top of
each other. So several must agree, they must have looked about rather than down one hall, and
whatever else the two parts would then both have seen must look the same from both.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof import se3
from slam_bof.consistency import agree
from slam_bof.types import Array, Loop, Params, Pose, Verification

__all__ = ["JoinGate", "JoinParams"]

Verify = Callable[[int, list[int], Array], list[Verification]]
"""Verifies a keyframe against others, from ``T_match_query`` (n, 4, 4)."""


class JoinParams(Params):
    """What loops that join two parts of the map need beyond those within one."""

    n_required: int = Field(4, gt=0, description="loops of different keyframes that agree")
    max_distance_m: float = Field(0.15, gt=0, description="by which they may disagree")
    max_angle_rad: float = Field(0.06, gt=0)
    look_about_rad: float = Field(0.8, ge=0, description="between their directions of view, or")
    walk_about_m: float = Field(3.0, ge=0, description="between the places they look from")
    same_view_m: float = Field(0.7, gt=0, description="views nearer than this, and")
    same_view_rad: float = Field(0.5, gt=0, description="turned less, must show the same")
    n_checked: int = Field(24, gt=0, description="of which so many are verified")
    min_agreeing: float = Field(0.6, ge=0, le=1, description="share that must agree")


class JoinGate:
    """Holds loops between parts of the map back until they are enough to join them."""

    def __init__(self, params: JoinParams, verify: Verify) -> None:
        self.params = params
        self._verify = verify
        self._pending: list[Loop] = []

    def admit(
        self, loops: list[Loop], T_map_camera: Array, parts: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Take the newest keyframe's loops to other parts; return those that join it to one.

        ``T_map_camera`` (K, 4, 4) are the keyframes' poses, each part's in a frame of its own,
        and ``parts`` (K,) which part they are in.
        """
        p = self.params
        self._pending = [
            loop for loop in self._pending if parts[loop.query_id] != parts[loop.match_id]
        ]
        for loop in loops:
            between = parts[loop.query_id], parts[loop.match_id]
            agreeing = [
                other
                for other in self._pending
                if (parts[other.query_id], parts[other.match_id]) == between
                and agree(loop, other, T_map_camera, p.max_distance_m, p.max_angle_rad)
            ]
            self._pending.append(loop)
            agreeing.append(loop)
            if self._is_enough(agreeing, T_map_camera) and self._is_confirmed(
                loop, T_map_camera, parts
            ):
                self._pending = [other for other in self._pending if other not in agreeing]
                return agreeing
        return []

    def _is_enough(self, loops: list[Loop], T_map_camera: Array) -> bool:
        """Tell whether these are of enough keyframes, and see enough of the place."""
        p = self.params
        query_ids = sorted({loop.query_id for loop in loops})
        if len(query_ids) < p.n_required:
            return False
        T = se3.inverse(T_map_camera[query_ids[0]]) @ T_map_camera[query_ids]
        walked_m = np.linalg.norm(T[:, :3, 3], axis=1).max()
        return bool(se3.rotation_angle(T).max() >= p.look_about_rad or walked_m >= p.walk_about_m)

    def _is_confirmed(
        self, loop: Loop, T_map_camera: Array, parts: NDArray[np.integer[Any]]
    ) -> bool:
        """Tell whether most views that the loop brings together show the same."""
        p = self.params
        pairs = self._same_views(loop, T_map_camera, parts)
        n_agreeing = 0
        for query_id, match_id, T_match_query in pairs:
            (verified,) = self._verify(query_id, [match_id], T_match_query[None])
            n_agreeing += verified.accepted
        return n_agreeing >= p.min_agreeing * len(pairs)

    def _same_views(
        self, loop: Loop, T_map_camera: Array, parts: NDArray[np.integer[Any]]
    ) -> list[tuple[int, int, Pose]]:
        """Return up to ``n_checked`` keyframes of the query's part, each with its likest view."""
        p = self.params
        match_ids = np.flatnonzero(parts == parts[loop.match_id])
        T_query_map = se3.inverse(T_map_camera[loop.query_id])
        T_map_other = T_map_camera[loop.match_id] @ loop.T_match_query @ T_query_map
        T_matches_map = se3.inverse(T_map_camera[match_ids])
        pairs = []
        for query_id in np.flatnonzero(parts == parts[loop.query_id]).tolist():
            T = T_matches_map @ (T_map_other @ T_map_camera[query_id])
            apart = np.maximum(
                np.linalg.norm(T[:, :3, 3], axis=1) / p.same_view_m,
                se3.rotation_angle(T) / p.same_view_rad,
            )
            likest = int(apart.argmin())
            if apart[likest] < 1.0:
                pairs.append((query_id, int(match_ids[likest]), T[likest]))
        chosen = np.linspace(0, len(pairs) - 1, min(len(pairs), p.n_checked)).astype(np.intp)
        return [pairs[i] for i in chosen]
