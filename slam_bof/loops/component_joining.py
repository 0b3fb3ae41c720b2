"""When loops may join two parts of the map, of which nothing says how they lie.

Drift cannot judge such a loop, and one that is wrong, two halls alike, lays whole rooms on top of
each other. So several must agree, they must have looked about rather than down one hall, and
what either part has seen must not stand where the other has looked through.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.loops.pairwise_consistency import agree
from slam_bof.places import Compare
from slam_bof.types import Array, Loop, Params

__all__ = ["JoinGate", "JoinParams"]

N_QUERIES = 100
"""So many keyframes of the younger part are asked what the older one has near."""


class JoinParams(Params):
    """What loops that join two parts of the map need beyond those within one."""

    n_required: int = Field(4, gt=0, description="loops of different keyframes that agree")
    max_distance_m: float = Field(0.15, gt=0, description="by which they may disagree")
    max_angle_rad: float = Field(0.06, gt=0)
    look_about_rad: float = Field(0.6, ge=0, description="between their directions of view, or")
    walk_about_m: float = Field(3.0, ge=0, description="between the places they look from")
    near_m: float = Field(2.5, gt=0, description="views that a join brings nearer than this,")
    near_rad: float = Field(1.0, gt=0, description="turned by less, are compared,")
    n_compared: int = Field(300, gt=0, description="so many of them")
    max_blocking: float = Field(
        0.2, ge=0, le=1, description="share of their points that may stand in free space"
    )


class JoinGate:
    """Holds loops between parts of the map back until they are enough to join them."""

    def __init__(self, params: JoinParams, compare: Compare | None = None) -> None:
        self.params = params
        self._compare = compare
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
            oriented = _from_younger(loop, parts)
            between = parts[oriented.query_id], parts[oriented.match_id]
            self._pending.append(loop)
            witnesses = [_from_younger(other, parts) for other in self._pending]
            agreed = agree(oriented, witnesses, T_map_camera, p.max_distance_m, p.max_angle_rad)
            agreed &= [(parts[w.query_id], parts[w.match_id]) == between for w in witnesses]
            agreeing = list(itertools.compress(self._pending, agreed))
            if (
                len({other.query_id for other in agreeing}) >= p.n_required
                and self._has_looked_about(itertools.compress(witnesses, agreed), T_map_camera)
                and self._is_free(oriented, T_map_camera, parts)
            ):
                self._pending = [other for other in self._pending if other not in agreeing]
                return agreeing
        return []

    def _has_looked_about(self, loops: Iterable[Loop], T_map_camera: Array) -> bool:
        """Tell whether the queries, or the matches, of either one part, see enough of the place.

        Any two of them may be those that look the most different ways, so that it does not matter
        which part came first.
        """
        p = self.params
        loops = list(loops)
        for ids in ({loop.query_id for loop in loops}, {loop.match_id for loop in loops}):
            T = T_map_camera[sorted(ids)]
            apart = se3.inverse(T)[:, None] @ T
            walked_m = np.linalg.norm(apart[..., :3, 3], axis=-1).max()
            if se3.rotation_angle(apart).max() >= p.look_about_rad or walked_m >= p.walk_about_m:
                return True
        return False

    def _is_free(self, loop: Loop, T_map_camera: Array, parts: NDArray[np.integer[Any]]) -> bool:
        """Tell whether either part leaves free what the other sees through, were they joined so.

        That holds through walls as well: what is behind what one sees contradicts nothing.
        """
        if self._compare is None:
            return True
        p = self.params
        match_ids = np.flatnonzero(parts == parts[loop.match_id])
        query_ids = np.flatnonzero(parts == parts[loop.query_id])
        query_ids = query_ids[:: -(-len(query_ids) // N_QUERIES)]
        T_query_map = se3.inverse(T_map_camera[loop.query_id])
        T_map_other = T_map_camera[loop.match_id] @ loop.T_match_query @ T_query_map
        T_queries = T_map_other @ T_map_camera[query_ids]
        T = se3.inverse(T_map_camera[match_ids])[None] @ T_queries[:, None]
        near = (np.linalg.norm(T[..., :3, 3], axis=-1) < p.near_m) & (
            se3.rotation_angle(T) < p.near_rad
        )
        pairs = np.argwhere(near)
        pairs = pairs[:: max(1, -(-len(pairs) // p.n_compared))]
        blocking = compared = 0.0
        for query in np.unique(pairs[:, 0]):
            matches = pairs[pairs[:, 0] == query, 1]
            found = self._compare(int(query_ids[query]), match_ids[matches], T[query, matches])
            blocking += float(found.blocking.sum())
            compared += float(found.compared.sum())
        return blocking <= p.max_blocking * compared


def _from_younger(loop: Loop, parts: NDArray[np.integer[Any]]) -> Loop:
    """Return the loop with its query in the younger part; its information, unused, stays."""
    if parts[loop.query_id] > parts[loop.match_id]:
        return loop
    return replace(
        loop,
        query_id=loop.match_id,
        match_id=loop.query_id,
        T_match_query=se3.inverse(loop.T_match_query),
    )
