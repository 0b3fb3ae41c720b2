"""Poses of frames, and trajectories."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

__all__ = ["LOST", "Array", "FramePose", "Pose", "Trajectory"]

Array = NDArray[np.float64]
Pose = NDArray[np.float64]
"""A rigid transform as a (4, 4) matrix."""

LOST = -1
"""Segment number of frames that were taken while odometry was lost."""


@dataclass(frozen=True, slots=True, eq=False)
class FramePose:
    """The poses (4, 4) of a frame from odometry (``T_odom_raw``) and after tracking.

    ``segment`` is the number of the uninterrupted track that the frame belongs to, or ``LOST``
    while odometry was lost. ``T_view_camera`` is the pose of the sensor in the virtual camera that
    its point cloud was projected into, and None for a depth image. ``step_covariance`` (6, 6), of
    keyframes alone, is that of the step since the keyframe before, if it is known.
    """

    stamp_s: float
    T_odom_raw: Pose
    T_odom_camera: Pose
    segment: int
    T_view_camera: Pose | None = None
    step_covariance: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Trajectory:
    """Time stamps (N,) in seconds, and the poses ``T_world_camera`` (N, 4, 4) at these times."""

    stamps_s: Array = field(default_factory=lambda: np.empty(0))
    poses: Array = field(default_factory=lambda: np.empty((0, 4, 4)))

    def __post_init__(self) -> None:
        """Check that there is one pose per time stamp."""
        for name in ("stamps_s", "poses"):
            found = getattr(self, name)
            if not isinstance(found, np.ndarray) or found.dtype.kind not in "fiu":
                kind = getattr(found, "dtype", type(found).__name__)
                raise ValueError(f"{name} must be an array of numbers, got {kind}")
        if self.stamps_s.ndim != 1:
            raise ValueError(f"stamps_s must be (N,), got {self.stamps_s.shape}")
        if self.poses.shape != (len(self.stamps_s), 4, 4):
            raise ValueError(f"poses must be ({len(self.stamps_s)}, 4, 4), got {self.poses.shape}")

    def __repr__(self) -> str:
        """Return how many poses there are, and from when to when."""
        if not len(self):
            return "Trajectory(no poses)"
        first_s, last_s = self.stamps_s[[0, -1]].tolist()
        return f"Trajectory({len(self)} poses from {first_s} to {last_s} s)"

    def __len__(self) -> int:
        """Return the number of poses."""
        return len(self.stamps_s)
