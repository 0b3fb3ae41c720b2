"""How often a description of a frame finds the place again: the protocol, the truth, the figures.

Every few frames of a sequence are a query, against those of them that are older by a margin.
Two truths: *pose*, the camera is back where it was, and *overlap*, both frames see the same
surfaces, which is what a geometric verification needs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.evaluation.loop_metrics import same_place
from slam_bof.geometry import back_project, se3
from slam_bof.types import Array, DepthFrame, Params, Pose, Trajectory

__all__ = ["ProtocolParams", "eligible", "overlap_shares", "truths"]


class ProtocolParams(Params):
    """Which frames ask, which may answer, and what is right."""

    every: int = Field(5, gt=0, description="each so many frames is a query and an answer")
    min_age_frames: int = Field(101, gt=0, description="an answer is so much older at least")
    max_distance_m: float = Field(0.3, gt=0, description="pose: between the two cameras")
    max_angle_deg: float = Field(25.0, gt=0, description="pose: between the two views")
    min_overlap: float = Field(0.5, gt=0, le=1, description="overlap: of either frame's surface")
    tolerance_m: float = Field(0.05, ge=0, description="overlap: of depth, plus a share of it")
    tolerance_share: float = Field(0.02, ge=0, description="overlap: of depth, of its range")
    stride: int = Field(4, gt=0, description="overlap: every so many pixels are projected")


def eligible(frame_indices: Sequence[int], params: ProtocolParams) -> NDArray[np.bool_]:
    """Tell which frames (columns) may answer which queries (rows), (K, K)."""
    index = np.asarray(frame_indices)
    return np.asarray(index[None, :] <= index[:, None] - params.min_age_frames)


def truths(
    frames: Sequence[DepthFrame],
    frame_indices: Sequence[int],
    reference: Trajectory,
    params: ProtocolParams,
) -> dict[str, NDArray[np.bool_]]:
    """Return what is right by ``pose`` and by ``overlap``, (K, K) each: query, answer.

    ``frame_indices`` (K,) are those of ``frames`` in ``reference``.
    """
    allowed = eligible(frame_indices, params)
    by_pose = same_place(
        frame_indices,
        reference,
        min_age_frames=params.min_age_frames,
        max_distance_m=params.max_distance_m,
        max_angle_rad=np.radians(params.max_angle_deg),
    )
    shares = overlap_shares(frames, reference.poses[list(frame_indices)], allowed, params)
    return {"pose": by_pose, "overlap": shares >= params.min_overlap}


def overlap_shares(
    frames: Sequence[DepthFrame],
    T_world_cameras: Array,
    pairs: NDArray[np.bool_],
    params: ProtocolParams,
) -> Array:
    """Return how much of either frame's surface both of a pair see, (K, K), 0 elsewhere.

    That is the smaller of two shares: of the one's points that the other sees, and the reverse.
    """
    depths_m = [frame.depth_m() for frame in frames]
    points = [
        back_project(frame.depth_m(params.stride), frame.intrinsics, params.stride)
        for frame in frames
    ]
    shares = np.zeros(pairs.shape)
    for a, b in np.argwhere(pairs):
        T_b_a = se3.inverse(T_world_cameras[b]) @ T_world_cameras[a]
        shares[a, b] = min(
            _seen(points[a], T_b_a, frames[b], depths_m[b], params),
            _seen(points[b], se3.inverse(T_b_a), frames[a], depths_m[a], params),
        )
    return shares


def _seen(
    points_a: Array, T_b_a: Pose, frame_b: DepthFrame, depth_b_m: Array, params: ProtocolParams
) -> float:
    """Return the share of a's points that b sees, at the depth where they are."""
    x, y, z = T_b_a[:3, :3] @ points_a.T + T_b_a[:3, 3:]
    camera = frame_b.intrinsics
    before = z > 0
    x, y, z = x[before], y[before], z[before]
    column = np.rint(x / z * camera.fx + camera.cx)
    row = np.rint(y / z * camera.fy + camera.cy)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    measured = depth_b_m[row[inside].astype(int), column[inside].astype(int)]
    expected = z[inside]
    off = np.abs(measured - expected)
    seen = (measured > 0) & (off < params.tolerance_m + params.tolerance_share * expected)
    return float(seen.sum() / len(points_a)) if len(points_a) else 0.0
