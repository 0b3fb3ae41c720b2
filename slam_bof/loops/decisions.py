"""Decisions about single candidates: does an alignment make a loop, and if not, why."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.loops.component_joining import ComponentJoiningParams
from slam_bof.loops.pairwise_consistency import ConsistencyParams
from slam_bof.types import (
    Array,
    Candidate,
    CandidateSource,
    Decision,
    EdgeKind,
    Loop,
    Params,
    Pose,
    Verification,
)

__all__ = ["MapPoses", "VerificationParams", "decide"]


class VerificationParams(Params):
    """What a loop needs in addition to a good alignment.

    A wrong loop bends the whole map, a wrong edge to a neighbour only a little, so a loop needs
    more. Layers along the optical axis change with the viewpoint, so two views with similar bags
    must be close to each other.
    """

    min_overlap: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Smallest share of points with a match that a loop needs.",
    )
    max_view_distance_m: float = Field(
        1.0,
        gt=0,
        description="Largest distance between two views that bags propose, in m.",
    )
    max_view_angle_rad: float = Field(
        0.7,
        gt=0,
        description="Largest angle between two views that bags propose, in rad.",
    )
    max_correction_m: float = Field(
        0.5,
        ge=0,
        description="Distance by which a loop may move the map, in m, before drift is added.",
    )
    max_correction_rad: float = Field(
        0.3,
        ge=0,
        description="Angle by which a loop may turn the map, in rad, before drift is added.",
    )
    drift_m_per_m: float = Field(
        0.05,
        ge=0,
        description="Drift in position that odometry may have, in m for each m travelled.",
    )
    drift_rad_per_m: float = Field(
        0.02,
        ge=0,
        description="Drift in direction that odometry may have, in rad for each m travelled.",
    )
    global_registration: Literal["if_needed", "always"] = Field(
        "if_needed",
        description="With bags: when a candidate is registered without an initial pose, which "
        "the verifier open3d does by RANSAC: if_needed where its pose in the map fails, always as "
        "in the paper.",
    )
    consistency: ConsistencyParams = ConsistencyParams()
    component_joining: ComponentJoiningParams = ComponentJoiningParams()


@dataclass(frozen=True, slots=True, eq=False)
class MapPoses:
    """Where the map has its keyframes, and how far that can be relied on.

    ``T_map_camera`` (K, 4, 4) are the poses of all keyframes so far. ``path_m`` (K,) is the length
    of the shortest path in the pose graph from each to the newest, over which the map may have
    drifted. ``components`` (K,) is the component of each; poses of different components cannot be
    compared.
    """

    T_map_camera: Array
    path_m: Array
    components: NDArray[np.integer[Any]]

    def joins_components(self, pair: Candidate | Loop) -> bool:
        """Return whether the two keyframes are in different components."""
        return bool(self.components[pair.query_id] != self.components[pair.match_id])

    def correction(self, pair: Candidate, T_match_query: Pose) -> Pose:
        """Return the motion (4, 4) that this relative pose of two keyframes asks of the map."""
        T_map_match, T_map_query = self.T_map_camera[[pair.match_id, pair.query_id]]
        motion: Pose = se3.inverse(T_match_query) @ se3.inverse(T_map_match) @ T_map_query
        return motion


def decide(
    candidate: Candidate, verified: Verification, poses: MapPoses, params: VerificationParams
) -> Candidate:
    """Return a candidate with its figures, its kind, the decision and the reason for it."""
    kind = candidate.kind
    if candidate.source == CandidateSource.PROXIMITY and verified.overlap < params.min_overlap:
        kind = EdgeKind.COVISIBILITY  # too little to claim a loop, but both see some surfaces
    if verified.n_open and kind == EdgeKind.COVISIBILITY:
        kind = EdgeKind.PARTIAL
    candidate = replace(candidate, kind=kind, overlap=verified.overlap, rmse_m=verified.rmse_m)
    if candidate.decision == Decision.ACCEPTED:
        decision, reason = _recheck(candidate, verified)
    else:
        reason = verified.reason or _reason_against(candidate, verified, poses, params)
        decision = Decision.REJECTED if reason else Decision.ACCEPTED
    return replace(candidate, decision=decision, reason=reason)


def _reason_against(
    candidate: Candidate, verified: Verification, poses: MapPoses, p: VerificationParams
) -> str:
    """Return why a well-aligned pair is no loop all the same, or nothing."""
    if candidate.kind != EdgeKind.LOOP:
        return ""
    if verified.n_open:
        return _open_reason(verified)
    if verified.overlap < p.min_overlap:
        return f"overlap {verified.overlap:.2f} below the {p.min_overlap:g} that a loop needs"
    distance_m, angle_rad = _size(verified.T_match_query)
    if candidate.source == CandidateSource.BAG and (
        distance_m > p.max_view_distance_m or angle_rad > p.max_view_angle_rad
    ):
        return f"views too far apart for like bags: {distance_m:.2f} m, {angle_rad:.2f} rad"
    if poses.joins_components(candidate):
        return ""
    between_m = float(poses.path_m[candidate.match_id])
    moved_m, turned_rad = _size(poses.correction(candidate, verified.T_match_query))
    if (
        moved_m > p.max_correction_m + p.drift_m_per_m * between_m
        or turned_rad > p.max_correction_rad + p.drift_rad_per_m * between_m
    ):
        return (
            f"would move the map by {moved_m:.2f} m and {turned_rad:.2f} rad, "
            f"more than drift over {between_m:.1f} m explains"
        )
    return ""


def _recheck(candidate: Candidate, verified: Verification) -> tuple[Decision, str]:
    """Return decision and reason of a candidate that recognition accepted already."""
    information = verified.information
    if verified.n_open and candidate.kind == EdgeKind.LOOP:
        return Decision.REJECTED, f"{candidate.reason}; {_open_reason(verified)}"
    if np.linalg.matrix_rank(information, tol=1e-9 * max(np.trace(information), 1.0)) < 6:
        return Decision.REJECTED, f"{candidate.reason}; no relative pose: {verified.reason}"
    reason_against = f"; geometry objects: {verified.reason}" if verified.reason else ""
    return Decision.ACCEPTED, candidate.reason + reason_against


def _open_reason(verified: Verification) -> str:
    return f"the surfaces leave {verified.n_open} of 6 directions open"


def _size(T: Pose) -> tuple[float, float]:
    """Return how far, in metres, and by what angle, in radians, a transform moves."""
    return float(np.linalg.norm(T[:3, 3])), float(se3.rotation_angle(T))
