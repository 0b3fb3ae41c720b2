"""Loops must agree with each other: a single one may be two places that look the same.

Two loops agree if going round them, by the one loop, the map between the queries, the other
loop back and the map between the matches, ends where it began (the pairwise
consistency of Mangelson et al., ICRA 2018, with fixed tolerances).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof import se3
from slam_bof.types import Array, Loop, Params, Pose

__all__ = ["ConsistencyGate", "ConsistencyParams", "circuit_error"]


class ConsistencyParams(Params):
    """How many other loops must agree, and how well."""

    n_required: int = Field(1, ge=0, description="loops of other keyframes that must agree")
    window: int = Field(8, gt=0, description="keyframes back that may still bear witness")
    max_distance_m: float = Field(0.1, gt=0)
    max_angle_rad: float = Field(0.06, gt=0)
    n_required_to_join: int = Field(3, ge=0, description="for a loop that joins parts of the map")


class ConsistencyGate:
    """Holds each verified loop back until enough others agree with it."""

    def __init__(self, params: ConsistencyParams) -> None:
        self.params = params
        self._recent: list[Loop] = []
        self._witnesses: dict[tuple[int, int], set[int]] = {}
        self._admitted: set[tuple[int, int]] = set()

    def admit(
        self, loops: list[Loop], T_map_camera: Array, parts: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Take the verified loops of one keyframe; return those admitted now, old ones too.

        ``T_map_camera`` (K, 4, 4) are the keyframes' poses in the map so far, ``parts`` (K,)
        which part of it they are in. Loops that could join two parts wait without limit.
        """
        p = self.params
        if p.n_required == 0:
            return loops
        admitted = []
        newest = len(T_map_camera) - 1
        self._recent = [
            loop
            for loop in self._recent
            if newest - loop.query_id <= p.window or parts[loop.query_id] != parts[loop.match_id]
        ]
        for loop in loops:
            for other in self._recent:
                if (
                    parts[loop.query_id] == parts[other.query_id]
                    and parts[loop.match_id] == parts[other.match_id]
                    and self._agree(loop, other, T_map_camera)
                ):
                    joins = parts[loop.query_id] != parts[loop.match_id]
                    required = p.n_required_to_join if joins else p.n_required
                    admitted += self._testify(other, loop.query_id, required)
                    admitted += self._testify(loop, other.query_id, required)
        self._recent += loops
        return admitted

    def _testify(self, loop: Loop, witness_id: int, required: int) -> list[Loop]:
        """Note a witness; return the loop if that makes it enough."""
        pair = loop.query_id, loop.match_id
        witnesses = self._witnesses.setdefault(pair, set())
        witnesses.add(witness_id)
        if pair in self._admitted or len(witnesses) < required:
            return []
        self._admitted.add(pair)
        return [loop]

    def _agree(self, a: Loop, b: Loop, T_map_camera: Array) -> bool:
        error = circuit_error(a, b, T_map_camera)
        return (
            float(np.linalg.norm(error[:3, 3])) <= self.params.max_distance_m
            and float(se3.rotation_angle(error)) <= self.params.max_angle_rad
        )


def circuit_error(a: Loop, b: Loop, T_map_camera: Array) -> Pose:
    """Return what is left (4, 4) of going round two loops and the map between them."""
    T_query_a_query_b = se3.inverse(T_map_camera[a.query_id]) @ T_map_camera[b.query_id]
    T_match_b_match_a = se3.inverse(T_map_camera[b.match_id]) @ T_map_camera[a.match_id]
    return np.asarray(
        a.T_match_query @ T_query_a_query_b @ se3.inverse(b.T_match_query) @ T_match_b_match_a
    )
