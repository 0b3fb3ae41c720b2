"""Loops must agree with each other: a single one may be two places that look the same.

Two loops agree if going round them, by the one loop, the map between the queries, the other
loop back and the map between the matches, ends where it began (the pairwise
consistency of Mangelson et al., ICRA 2018, with fixed tolerances).
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof import se3
from slam_bof.types import Array, Loop, Params, Pose

__all__ = ["ConsistencyGate", "ConsistencyParams", "agree", "circuit_error"]


class ConsistencyParams(Params):
    """How many other loops must agree, and how well."""

    n_required: int = Field(1, ge=0, description="loops of other keyframes that must agree")
    window: int = Field(8, gt=0, description="keyframes back that may still bear witness")
    max_distance_m: float = Field(0.1, gt=0)
    max_angle_rad: float = Field(0.06, gt=0)


class ConsistencyGate:
    """Holds each verified loop back until enough others agree with it."""

    def __init__(self, params: ConsistencyParams) -> None:
        self.params = params
        self._recent: list[Loop] = []
        self._witnesses: dict[tuple[int, int], set[int]] = {}

    def admit(self, loops: list[Loop], T_map_camera: Array) -> list[Loop]:
        """Take the verified loops of one keyframe; return those admitted now, old ones too.

        ``T_map_camera`` (K, 4, 4) are the keyframes' poses in the map so far.
        """
        p = self.params
        if p.n_required == 0:
            return loops
        admitted = []
        newest = len(T_map_camera) - 1
        self._recent = [loop for loop in self._recent if newest - loop.query_id <= p.window]
        for loop in loops:
            for other in self._recent:
                if agree(loop, other, T_map_camera, p.max_distance_m, p.max_angle_rad):
                    admitted += self._testify(other, loop.query_id)
                    admitted += self._testify(loop, other.query_id)
        self._recent += loops
        return admitted

    def _testify(self, loop: Loop, witness_id: int) -> list[Loop]:
        """Note a witness; return the loop if that makes it enough."""
        witnesses = self._witnesses.setdefault((loop.query_id, loop.match_id), set())
        before = len(witnesses)
        witnesses.add(witness_id)
        required = self.params.n_required
        return [loop] if before < required <= len(witnesses) else []


def agree(
    a: Loop, b: Loop, T_map_camera: Array, max_distance_m: float, max_angle_rad: float
) -> bool:
    """Tell whether going round two loops ends where it began, to within the given."""
    error = circuit_error(a, b, T_map_camera)
    return (
        float(np.linalg.norm(error[:3, 3])) <= max_distance_m
        and float(se3.rotation_angle(error)) <= max_angle_rad
    )


def circuit_error(a: Loop, b: Loop, T_map_camera: Array) -> Pose:
    """Return what is left (4, 4) of going round two loops and the map between them."""
    T_query_a_query_b = se3.inverse(T_map_camera[a.query_id]) @ T_map_camera[b.query_id]
    T_match_b_match_a = se3.inverse(T_map_camera[b.match_id]) @ T_map_camera[a.match_id]
    return np.asarray(
        a.T_match_query @ T_query_a_query_b @ se3.inverse(b.T_match_query) @ T_match_b_match_a
    )
