"""Errors of single poses in a map against true poses in another frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["PoseAccuracy", "align_poses", "pose_accuracy"]

AGREE_M, AGREE_RAD = 0.1, np.radians(5.0)
"""Two poses agree with an alignment if their error is below these limits."""
N_TRIED = 100
"""Largest number of poses tried as the one that aligns all."""


@dataclass(frozen=True, slots=True)
class PoseAccuracy:
    """Errors of the ``n_known`` frames, of ``n`` with a true pose, whose pose was estimated.

    ``within`` is the share of them whose error is at most (metres, degrees); ``median_m`` and
    ``median_deg`` are median errors.
    """

    n: int
    n_known: int
    within: dict[tuple[float, float], float]
    median_m: float
    median_deg: float


def pose_accuracy(
    T_map_camera: Array,
    T_world_camera: Array,
    limits: tuple[tuple[float, float], ...] = ((0.05, 5.0), (0.1, 10.0), (0.25, 10.0)),
) -> PoseAccuracy | None:
    """Measure poses (N, 4, 4), NaN where unknown, against true poses; None if none can be.

    The map is aligned with the world by the largest set of poses that agree with each other, so
    that wrong poses do not change the errors of the right ones.
    """
    true = np.isfinite(T_world_camera).all(axis=(1, 2))
    both = true & np.isfinite(T_map_camera).all(axis=(1, 2))
    if not both.any():
        return None
    found, truth = T_map_camera[both], T_world_camera[both]
    errors = se3.inverse(truth) @ align_poses(found, truth) @ found
    error_m = np.linalg.norm(errors[:, :3, 3], axis=1)
    error_deg = np.degrees(np.atleast_1d(se3.rotation_angle(errors)))
    within = {
        (metres, degrees): float(((error_m <= metres) & (error_deg <= degrees)).mean())
        for metres, degrees in limits
    }
    return PoseAccuracy(
        n=int(true.sum()),
        n_known=int(both.sum()),
        within=within,
        median_m=float(np.median(error_m)),
        median_deg=float(np.median(error_deg)),
    )


def align_poses(T_map_camera: Array, T_world_camera: Array) -> Pose:
    """Return ``T_world_map`` (4, 4) on which most of N > 0 pairs of poses (N, 4, 4) agree."""
    each = T_world_camera @ se3.inverse(T_map_camera)
    best = np.zeros(len(each), dtype=bool)
    for T in each[:: -(-len(each) // N_TRIED)]:
        errors = se3.inverse(T_world_camera) @ T @ T_map_camera
        agree = np.linalg.norm(errors[:, :3, 3], axis=1) < AGREE_M
        agree &= np.atleast_1d(se3.rotation_angle(errors)) < AGREE_RAD
        if agree.sum() > best.sum():
            best = agree
    R = se3.nearest_rotation(each[best, :3, :3].mean(axis=0))
    moved = T_map_camera[best, :3, 3] @ R.T
    return se3.pose(R, (T_world_camera[best, :3, 3] - moved).mean(axis=0))
