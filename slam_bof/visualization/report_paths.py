"""The paths and edges that a run's report draws, aligned with ground truth where it is known."""

from __future__ import annotations

import numpy as np

from slam_bof import evaluation
from slam_bof.geometry import se3
from slam_bof.types import Array, EdgeKind, Pose, Trajectory
from slam_bof.visualization.report_data import ReportData

__all__ = [
    "aligned_poses",
    "by_component",
    "level_axes",
    "loop_links",
    "loop_texts",
    "truth_by_frame",
]

MAX_LISTED = 20
"""Number of loops of one keyframe that are listed."""


def truth_by_frame(data: ReportData) -> Trajectory | None:
    """Return the true pose of each frame, NaN where unknown; None if too few are known."""
    if data.groundtruth is None:
        return None
    if evaluation.align_trajectory(data.optimized, data.groundtruth) is None:
        return None
    i, j = evaluation.associate(data.optimized, data.groundtruth)
    poses = np.full(data.optimized.poses.shape, np.nan)
    poses[i] = data.groundtruth.poses[j]
    return Trajectory(data.optimized.stamps_s, poses)


def aligned_poses(data: ReportData, truth: Trajectory | None) -> dict[str, Array]:
    """Return the poses to draw, (N, 4, 4) by name, in the frame of the ground truth if known."""
    poses = {"odometry": data.odometry.poses, "optimized": data.optimized.poses}
    if truth is None:
        return poses
    known = np.isfinite(truth.poses).all(axis=(1, 2))
    for name, T_map_camera in poses.items():
        reference, estimate = (p[known, :3, 3] for p in (truth.poses, T_map_camera))
        poses[name] = se3.align(reference, estimate) @ T_map_camera
    return {**poses, "groundtruth": truth.poses}


def loop_links(data: ReportData, truth: Trajectory | None, keyframes: Array) -> dict[str, Array]:
    """Return the end points (L, 2, 3) of covisibility edges, loops, and wrong loops."""
    ids = np.array([(loop.match_id, loop.query_id) for loop in data.loops], dtype=np.intp)
    ends = keyframes[ids.reshape(-1, 2)]
    far = np.array([loop.kind == EdgeKind.LOOP for loop in data.loops], dtype=bool)
    wrong = np.zeros(len(far), dtype=bool)
    if truth is not None:
        indices = data.frame_indices
        for i, loop in enumerate(data.loops):
            wrong[i] = far[i] and evaluation.loop_precision([loop], indices, truth) == 0.0
    links = {"covisibility": ends[~far], "loop": ends[far & ~wrong], "wrong": ends[wrong]}
    return {name: pairs for name, pairs in links.items() if len(pairs)}


def loop_texts(data: ReportData) -> list[str]:
    """Return the number of each keyframe, with those that it has loops with."""
    partners: dict[int, set[int]] = {keyframe.id: set() for keyframe in data.keyframes}
    for loop in data.loops:
        if loop.kind == EdgeKind.LOOP:
            partners[loop.query_id].add(loop.match_id)
            partners[loop.match_id].add(loop.query_id)
    texts = []
    for k, others in partners.items():
        listed = ", ".join(map(str, sorted(others)[:MAX_LISTED]))
        more = f" and {len(others) - MAX_LISTED} more" if len(others) > MAX_LISTED else ""
        texts.append(f"keyframe {k}" + (f"<br>loops with {listed}{more}" if others else ""))
    return texts


def by_component(path: Array, data: ReportData) -> dict[str, Array]:
    """Return the path (N, 3) of each component, NaN at the frames of others.

    The largest is ``optimized``. A frame belongs to the component of the newest keyframe so far.
    """
    if len(set(data.components)) < 2:
        return {"optimized": path}
    newest = np.searchsorted(data.frame_indices, np.arange(len(path)), "right") - 1
    of_frame = np.array(data.components)[newest.clip(0)]
    numbers, counts = np.unique(of_frame, return_counts=True)
    largest = numbers[counts.argmax()]
    return {
        "optimized" if n == largest else f"component {n}": np.where(
            (of_frame == n)[:, None], path, np.nan
        )
        for n in numbers.tolist()
    }


def level_axes(T_world_camera: Array) -> Pose:
    """Return T_view_world of poses (N, 4, 4): x right, y forward, z up, the first pose at 0.

    Up is the mean direction of the cameras' tops, forward the view of the first camera.
    """
    if len(T_world_camera) == 0:
        return np.eye(4)
    up = -T_world_camera[:, :3, 1].mean(axis=0)
    forward = T_world_camera[0, :3, 2]
    if np.linalg.norm(np.cross(forward, up)) < 1e-6:
        up, forward = -T_world_camera[0, :3, 1], T_world_camera[0, :3, 2]
    up = up / np.linalg.norm(up)
    right = np.cross(forward, up)
    right = right / np.linalg.norm(right)
    R = np.stack([right, np.cross(up, right), up])
    return se3.pose(R, -R @ T_world_camera[0, :3, 3])
