"""From candidates to loops: by geometry, by viewpoint, by agreement with other loops."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import is_partial, se3
from slam_bof.loops.component_joining import JoinGate, JoinParams
from slam_bof.loops.pairwise_consistency import ConsistencyGate, ConsistencyParams
from slam_bof.places import Compare
from slam_bof.ports import Verifier
from slam_bof.types import Array, Candidate, DepthFrame, Loop, Params, Pose, Verification

__all__ = ["LoopVerification", "VerificationParams", "Verified"]


class VerificationParams(Params):
    """What a loop needs beyond the verifier's word.

    A wrong loop bends the whole map, a wrong edge to a neighbour only a little, so loops are
    held to more. Layers along the optical axis change with the viewpoint, so where two bags are
    alike the views are too.
    """

    min_overlap: float = Field(0.6, ge=0, le=1, description="of a loop's two clouds")
    max_view_distance_m: float = Field(1.0, gt=0, description="between views with like bags")
    max_view_angle_rad: float = Field(0.7, gt=0, description="between views with like bags")
    slack_m: float = Field(0.5, ge=0, description="a loop may move the map by this, plus drift")
    slack_rad: float = Field(0.3, ge=0, description="and turn it by this, plus drift")
    drift_m_per_m: float = Field(0.05, ge=0, description="drift that odometry may have")
    drift_rad_per_m: float = Field(0.02, ge=0, description="and its turn")
    consistency: ConsistencyParams = ConsistencyParams()
    joining: JoinParams = JoinParams()


class Verified(NamedTuple):
    """What came of a keyframe's candidates."""

    candidates: list[Candidate]
    """The same, with figures, decision and reason. ``held`` is a loop that waits for others."""
    measured: list[Loop]
    """All that geometry accepts, held ones too."""
    admitted: list[Loop]
    """The edges to add now, among them loops of earlier keyframes held back so far."""


class LoopVerification:
    """Keeps the keyframes' clouds and verifies candidates between them."""

    def __init__(
        self,
        verifier: Verifier,
        params: VerificationParams,
        *,
        compare: Compare | None = None,
        seed: int = 0,
    ) -> None:
        self.params = params
        self._verifier = verifier
        self._gate = ConsistencyGate(params.consistency)
        self._join_gate = JoinGate(params.joining, compare)
        self._seed = seed
        self._prepared: list[Any] = []

    def add(self, frame: DepthFrame, points_camera: Array) -> None:
        """Take the next keyframe: its depth image, and the points (N, 3) chosen of it."""
        self._prepared.append(self._verifier.prepare(frame, points_camera))

    def verify(
        self,
        candidates: Sequence[Candidate],
        T_map_camera: Array,
        *,
        parts: NDArray[np.integer[Any]] | None = None,
        guesses: Mapping[int, Pose] = MappingProxyType({}),
    ) -> Verified:
        """Judge the candidates of the newest keyframe that are still open.

        Those accepted already are aligned for their pose; the verdict does not veto them, but
        where so few points meet that the pose stays open there is no edge.

        ``T_map_camera`` (K, 4, 4) are all keyframes' poses in the map so far, and ``parts`` (K,)
        which part of it they are in, as ``parts.MapParts`` has it (without: all in one); those of
        different parts say nothing of each other. ``guesses`` are ``T_match_query`` that
        recognition has already, by ``match_id``.
        """
        if parts is None:
            parts = np.zeros(len(T_map_camera), dtype=np.int64)
        judged: list[Candidate] = []
        edges: list[Loop] = []
        loops: list[Loop] = []
        still_open = [c for c in candidates if c.decision != "rejected"]
        aligned = iter(self._align(still_open, T_map_camera, guesses))
        for candidate in candidates:
            if candidate.decision == "rejected":
                judged.append(candidate)
                continue
            verified = next(aligned)
            if candidate.source == "proximity" and verified.overlap < self.params.min_overlap:
                # Too little to claim a loop, but two views of the same surfaces all the same.
                candidate = replace(candidate, kind="covisibility")
            if candidate.decision == "accepted":
                decision, reason = _take(candidate, verified)
            else:
                reason = verified.reason or self._object(candidate, verified, T_map_camera, parts)
                decision = "rejected" if reason else "accepted"
            if decision == "accepted":
                if candidate.kind == "loop" and is_partial(verified.information):
                    candidate = replace(candidate, kind="partial")
                loop = Loop(
                    candidate.query_id,
                    candidate.match_id,
                    verified.T_match_query,
                    verified.information,
                    candidate.kind,
                    candidate.source,
                )
                (edges if candidate.kind == "covisibility" else loops).append(loop)
            judged.append(
                replace(
                    candidate,
                    overlap=verified.overlap,
                    rmse_m=verified.rmse_m,
                    decision=decision,
                    reason=reason,
                )
            )
        admitted = self.admit(loops, T_map_camera, parts)
        return Verified(_hold(judged, admitted, parts), edges + loops, edges + admitted)

    def admit(
        self, loops: Sequence[Loop], T_map_camera: Array, parts: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Take the newest keyframe's verified loops; return those that others agree with now."""
        within = [loop for loop in loops if parts[loop.query_id] == parts[loop.match_id]]
        between = [
            loop
            for loop in loops
            if parts[loop.query_id] != parts[loop.match_id] and loop.kind != "partial"
        ]
        admitted = self._gate.admit(within, T_map_camera)
        return admitted + self._join_gate.admit(between, T_map_camera, parts)

    def _align(
        self, candidates: Sequence[Candidate], T_map_camera: Array, guesses: Mapping[int, Pose]
    ) -> list[Verification]:
        """Align from the guess or else from where the map has the two; like bags, from nothing.

        Where the map is good already, the global search, ten times the cost, is spared.
        """
        if not candidates:
            return []
        query_id = candidates[0].query_id
        match_ids = [candidate.match_id for candidate in candidates]
        T_match_query = se3.inverse(T_map_camera[match_ids]) @ T_map_camera[query_id]
        for k, match_id in enumerate(match_ids):
            T_match_query[k] = guesses.get(match_id, T_match_query[k])
        query = self._prepared[query_id]
        matches = [self._prepared[match_id] for match_id in match_ids]
        verified = self._verifier.verify(query, matches, T_match_query=T_match_query)
        again = [
            k
            for k, candidate in enumerate(candidates)
            if candidate.source == "bag" and not verified[k].accepted
        ]
        found = self._verifier.verify(query, [matches[k] for k in again], seed=self._seed)
        for k, verification in zip(again, found, strict=True):
            verified[k] = verification
        return verified

    def _object(
        self,
        candidate: Candidate,
        verified: Verification,
        T_map_camera: Array,
        parts: NDArray[np.integer[Any]],
    ) -> str:
        """Return why a well-aligned pair is no loop all the same, or nothing."""
        p = self.params
        if candidate.kind != "loop":
            return ""
        if verified.overlap < p.min_overlap:
            return f"overlap {verified.overlap:.2f} below the {p.min_overlap:g} that a loop needs"
        distance_m, angle_rad = _size(verified.T_match_query)
        if candidate.source == "bag" and (
            distance_m > p.max_view_distance_m or angle_rad > p.max_view_angle_rad
        ):
            return f"views too far apart for like bags: {distance_m:.2f} m, {angle_rad:.2f} rad"
        if parts[candidate.match_id] != parts[candidate.query_id]:
            return ""
        way = slice(candidate.match_id, candidate.query_id + 1)
        between = T_map_camera[way]
        steps_m = np.linalg.norm(np.diff(between[:, :3, 3], axis=0), axis=1)
        # How far parts of the map are from each other says nothing of how far the camera went.
        path_m = float(steps_m[np.diff(parts[way]) == 0].sum())
        moved_m, turned_rad = _size(
            se3.inverse(verified.T_match_query) @ se3.inverse(between[0]) @ between[-1]
        )
        if (
            moved_m > p.slack_m + p.drift_m_per_m * path_m
            or turned_rad > p.slack_rad + p.drift_rad_per_m * path_m
        ):
            return (
                f"would move the map by {moved_m:.2f} m and {turned_rad:.2f} rad, "
                f"more than drift over {path_m:.1f} m explains"
            )
        return ""


def _take(candidate: Candidate, verified: Verification) -> tuple[str, str]:
    """Return decision and reason of a candidate that recognition accepted already."""
    information = verified.information
    if np.linalg.matrix_rank(information, tol=1e-9 * max(np.trace(information), 1.0)) < 6:
        return "rejected", f"{candidate.reason}; no relative pose: {verified.reason}"
    objection = f"; geometry objects: {verified.reason}" if verified.reason else ""
    return "accepted", candidate.reason + objection


def _size(T: Pose) -> tuple[float, float]:
    """Return how far, in metres, and by what angle, in radians, a transform moves."""
    return float(np.linalg.norm(T[:3, 3])), float(se3.rotation_angle(T))


def _hold(
    judged: list[Candidate], admitted: list[Loop], parts: NDArray[np.integer[Any]]
) -> list[Candidate]:
    """Mark the loops that were verified but not admitted yet."""
    pairs = {(loop.query_id, loop.match_id) for loop in admitted}

    def hold(candidate: Candidate) -> Candidate:
        pair = candidate.query_id, candidate.match_id
        is_edge = candidate.kind == "covisibility"
        if candidate.decision != "accepted" or is_edge or pair in pairs:
            return candidate
        reason = "no loop of another keyframe agrees with it"
        if parts[candidate.query_id] != parts[candidate.match_id]:
            reason = "not enough yet to join two parts of the map"
        return replace(candidate, decision="held", reason=reason)

    return [hold(candidate) for candidate in judged]
