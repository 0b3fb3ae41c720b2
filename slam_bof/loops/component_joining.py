"""Join two components of the pose graph by loops between them.

The relative pose of two components is unknown, so odometry cannot contradict a wrong loop between
them, and a wrong one (two halls that look the same) lays whole rooms over each other. Therefore
several loops must agree, they must see the place from different directions or positions, and
after joining, the surfaces of one component must not stand in space that the other has seen to be
free.
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

__all__ = ["ComponentJoiningGate", "ComponentJoiningParams"]

N_QUERIES = 100
"""Largest number of keyframes of the younger component that are compared with nearby ones of the
older."""


class ComponentJoiningParams(Params):
    """What loops between two components need, beyond what loops within one need."""

    n_required: int = Field(
        4,
        gt=0,
        description="Number of loops from different keyframes that must agree to join two "
        "components.",
    )
    max_distance_m: float = Field(
        0.15,
        gt=0,
        description="Largest distance by which two loops may disagree, in m.",
    )
    max_angle_rad: float = Field(
        0.06,
        gt=0,
        description="Largest angle by which two loops may disagree, in rad.",
    )
    min_view_spread_rad: float = Field(
        0.6,
        ge=0,
        description="Angle between viewing directions of the loops, in rad, from which the place "
        "counts as seen from several sides.",
    )
    min_position_spread_m: float = Field(
        3.0,
        ge=0,
        description="Distance between viewpoints of the loops, in m, that counts as such too.",
    )
    max_pair_distance_m: float = Field(
        2.5,
        gt=0,
        description="Views of the two components are compared where the join brings them closer "
        "than this, in m.",
    )
    max_pair_angle_rad: float = Field(
        1.0,
        gt=0,
        description="Views are compared where their directions then differ by less than this, in "
        "rad.",
    )
    n_pairs: int = Field(
        300,
        gt=0,
        description="Largest number of pairs of views that are compared.",
    )
    max_free_space_violation: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Largest share of compared points of one component that may stand in space the "
        "other has seen to be free.",
    )


class ComponentJoiningGate:
    """Holds loops between components back until enough of them agree to join the two."""

    def __init__(self, params: ComponentJoiningParams, compare: Compare | None = None) -> None:
        self.params = params
        self._compare = compare
        self._pending: list[Loop] = []

    def admit(
        self, loops: list[Loop], T_map_camera: Array, components: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Take the newest keyframe's loops to other components; return those that join two of them.

        ``T_map_camera`` (K, 4, 4) are the keyframes' poses, each component in a frame of its own,
        and ``components`` (K,) the component of each.
        """
        self._pending = [
            loop for loop in self._pending if components[loop.query_id] != components[loop.match_id]
        ]
        self._pending += loops
        admitted: list[Loop] = []
        joined: set[frozenset[int]] = set()
        for loop in loops:
            pair = _pair(loop, components)
            if pair in joined:
                continue  # this loop either agrees, and is admitted, or contradicts the join
            agreeing = self._agreeing(loop, T_map_camera, components)
            if self._is_enough(loop, agreeing, T_map_camera, components):
                joined.add(pair)
                admitted += agreeing
        self._pending = [loop for loop in self._pending if loop not in admitted]
        return admitted

    @property
    def waiting(self) -> list[Loop]:
        """The loops that wait for others to join two components."""
        return self._pending

    def _agreeing(
        self, loop: Loop, T_map_camera: Array, components: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Return the loops, this one among them, that place its two components as it does."""
        p, pair = self.params, _pair(loop, components)
        others = [other for other in self._pending if _pair(other, components) == pair]
        agreed = agree(
            _from_younger(loop, components),
            [_from_younger(other, components) for other in others],
            T_map_camera,
            p.max_distance_m,
            p.max_angle_rad,
        )
        return list(itertools.compress(others, agreed))

    def _is_enough(
        self,
        loop: Loop,
        agreeing: list[Loop],
        T_map_camera: Array,
        components: NDArray[np.integer[Any]],
    ) -> bool:
        """Return whether loops that agree are enough to join their two components."""
        oriented = [_from_younger(other, components) for other in agreeing]
        return (
            len({other.query_id for other in agreeing}) >= self.params.n_required
            and self._is_seen_from_several_sides(oriented, T_map_camera)
            and self._is_free(_from_younger(loop, components), T_map_camera, components)
        )

    def _is_seen_from_several_sides(self, loops: Iterable[Loop], T_map_camera: Array) -> bool:
        """Return whether the loops see the place from different directions or positions.

        It is enough that the queries do, or the matches, so that it does not matter which
        component came first.
        """
        p = self.params
        loops = list(loops)
        for ids in ({loop.query_id for loop in loops}, {loop.match_id for loop in loops}):
            T = T_map_camera[sorted(ids)]
            apart = se3.inverse(T)[:, None] @ T
            walked_m = np.linalg.norm(apart[..., :3, 3], axis=-1).max()
            if (
                se3.rotation_angle(apart).max() >= p.min_view_spread_rad
                or walked_m >= p.min_position_spread_m
            ):
                return True
        return False

    def _is_free(
        self, loop: Loop, T_map_camera: Array, components: NDArray[np.integer[Any]]
    ) -> bool:
        """Return whether each component leaves free what the other has seen to be free.

        Points that lie behind what a view sees are hidden and contradict nothing, so views on
        both sides of a wall can be compared.
        """
        if self._compare is None:
            return True
        p = self.params
        match_ids = np.flatnonzero(components == components[loop.match_id])
        query_ids = np.flatnonzero(components == components[loop.query_id])
        query_ids = query_ids[:: -(-len(query_ids) // N_QUERIES)]
        T_query_map = se3.inverse(T_map_camera[loop.query_id])
        T_map_other = T_map_camera[loop.match_id] @ loop.T_match_query @ T_query_map
        T_queries = T_map_other @ T_map_camera[query_ids]
        T = se3.inverse(T_map_camera[match_ids])[None] @ T_queries[:, None]
        near = (np.linalg.norm(T[..., :3, 3], axis=-1) < p.max_pair_distance_m) & (
            se3.rotation_angle(T) < p.max_pair_angle_rad
        )
        pairs = np.argwhere(near)
        pairs = pairs[:: max(1, -(-len(pairs) // p.n_pairs))]
        free_space_violation = visible_ratio = 0.0
        for query in np.unique(pairs[:, 0]):
            matches = pairs[pairs[:, 0] == query, 1]
            found = self._compare(int(query_ids[query]), match_ids[matches], T[query, matches])
            free_space_violation += float(found.free_space_violation.sum())
            visible_ratio += float(found.visible_ratio.sum())
        return free_space_violation <= p.max_free_space_violation * visible_ratio


def _pair(loop: Loop, components: NDArray[np.integer[Any]]) -> frozenset[int]:
    """Return the two components that a loop is between."""
    return frozenset((int(components[loop.query_id]), int(components[loop.match_id])))


def _from_younger(loop: Loop, components: NDArray[np.integer[Any]]) -> Loop:
    """Return the loop with its query in the younger component; its information, unused, stays."""
    if components[loop.query_id] > components[loop.match_id]:
        return loop
    return replace(
        loop,
        query_id=loop.match_id,
        match_id=loop.query_id,
        T_match_query=se3.inverse(loop.T_match_query),
    )
