"""Pairwise consistency of loops, since a single loop may connect two places that look the same.

Two loops agree if the circuit of one loop, the map between the queries, the other loop in reverse
and the map between the matches closes: the pairwise consistency of Mangelson et al. (ICRA 2018),
with fixed tolerances.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Array, Loop, Params

__all__ = ["ConsistencyGate", "ConsistencyParams", "agree", "circuit_errors"]


class ConsistencyParams(Params):
    """Number of other loops that must agree with a loop, and the tolerances."""

    n_required: int = Field(
        1,
        ge=0,
        description="Number of loops of other keyframes that must agree with a loop; 0 turns the "
        "check off.",
    )
    window: int = Field(
        8,
        gt=0,
        description="Number of keyframes for which a loop waits for others to agree.",
    )
    max_distance_m: float = Field(
        0.1,
        gt=0,
        description="Largest distance by which two loops may disagree, in m.",
    )
    max_angle_rad: float = Field(
        0.06,
        gt=0,
        description="Largest angle by which two loops may disagree, in rad.",
    )


@dataclass(slots=True, eq=False)
class _Held:
    """A loop and the keyframes whose loops agree with it."""

    loop: Loop
    supporters: set[int] = field(default_factory=set)


class ConsistencyGate:
    """Holds each verified loop back until enough others agree with it."""

    def __init__(self, params: ConsistencyParams) -> None:
        self.params = params
        self._recent: list[_Held] = []

    def admit(
        self, loops: list[Loop], T_map_camera: Array, components: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Add the verified loops of a keyframe; return all loops that now have enough agreement.

        ``T_map_camera`` (K, 4, 4) are the poses of the keyframes in the map, and ``components``
        (K,) their components. Each loop lies within one component. Only loops within the same
        component can agree, because the pose between two components is arbitrary.
        """
        p = self.params
        if p.n_required == 0:
            return loops
        admitted = []
        newest = len(T_map_camera) - 1
        self._recent = [old for old in self._recent if newest - old.loop.query_id <= p.window]
        recent = [old.loop for old in self._recent]
        query_ids = np.array([loop.query_id for loop in recent], np.intp)
        new = [_Held(loop) for loop in loops]
        for one in new:
            agreed = agree(one.loop, recent, T_map_camera, p.max_distance_m, p.max_angle_rad)
            agreed &= components[query_ids] == components[one.loop.query_id]
            for other in itertools.compress(self._recent, agreed):
                admitted += self._add_supporter(other, one.loop.query_id)
                admitted += self._add_supporter(one, other.loop.query_id)
        self._recent += new
        return admitted

    @property
    def waiting(self) -> list[Loop]:
        """The loops that wait for others, or that others may still agree with."""
        return [held.loop for held in self._recent]

    def _add_supporter(self, held: _Held, supporter_id: int) -> list[Loop]:
        """Add a supporter; return the loop if it now has just enough of them."""
        before = len(held.supporters)
        held.supporters.add(supporter_id)
        return [held.loop] if before < self.params.n_required <= len(held.supporters) else []


def agree(
    loop: Loop,
    others: Sequence[Loop],
    T_map_camera: Array,
    max_distance_m: float,
    max_angle_rad: float,
) -> NDArray[np.bool_]:
    """Return for each other loop (n,) whether its circuit with this one closes."""
    errors = circuit_errors(loop, others, T_map_camera)
    return np.asarray(
        (np.linalg.norm(errors[:, :3, 3], axis=1) <= max_distance_m)
        & (se3.rotation_angle(errors) <= max_angle_rad)
    )


def circuit_errors(loop: Loop, others: Sequence[Loop], T_map_camera: Array) -> Array:
    """Return the error (n, 4, 4) of the circuit of a loop with each of the others.

    The map leads from query to query and from match to match.
    """
    T_map_query = T_map_camera[[other.query_id for other in others]].reshape(-1, 4, 4)
    T_map_match = T_map_camera[[other.match_id for other in others]].reshape(-1, 4, 4)
    T_match_query = np.array([other.T_match_query for other in others]).reshape(-1, 4, 4)
    out = loop.T_match_query @ se3.inverse(T_map_camera[loop.query_id]) @ T_map_query
    back = se3.inverse(T_match_query) @ se3.inverse(T_map_match) @ T_map_camera[loop.match_id]
    return np.asarray(out @ back)
