"""Which frames the map keeps."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Params, Pose

__all__ = ["KeyframeParams", "KeyframeSelector"]


REST_M, REST_RAD = 0.005, 0.005
"""A camera that is closer than this to the last keyframe, in both, stands still."""


class KeyframeParams(Params):
    """Policy ``motion`` keeps a frame that moved enough; ``every`` the paper's k-th frame."""

    policy: Literal["motion", "every"] = Field(
        "motion",
        description="How keyframes are chosen: by motion, or every k-th frame as in the paper.",
    )
    distance_m: float = Field(
        0.12,
        gt=0,
        description="With motion: distance from the last keyframe at which a frame becomes one, in "
        "m.",
    )
    angle_rad: float = Field(
        0.2,
        gt=0,
        description="With motion: angle from the last keyframe at which a frame becomes one, in "
        "rad.",
    )
    max_gap: int = Field(
        10,
        gt=0,
        description="With motion: largest number of frames from one keyframe to the next, unless "
        "the camera stands still.",
    )
    min_inlier_ratio: float = Field(
        0.4,
        le=1,
        description="With motion: a frame that sees a smaller share of the last keyframe than this "
        "becomes one.",
    )
    every: int = Field(
        10,
        gt=0,
        description="With every: number of frames from one keyframe to the next.",
    )


class KeyframeSelector:
    """Says of each frame in turn whether it becomes a keyframe; the first always does."""

    def __init__(self, params: KeyframeParams) -> None:
        self.params = params
        self._frame_index = -1
        self._T_odom_camera: Pose | None = None

    def select(
        self, frame_index: int, T_odom_camera: Pose, *, inlier_ratio: float = float("nan")
    ) -> bool:
        """Decide for one frame, and remember it if the answer is yes.

        ``inlier_ratio`` is the share of its points that the last keyframe sees too, NaN where it
        was not measured.
        """
        chosen = self._T_odom_camera is None or self._is_due(
            frame_index, T_odom_camera, inlier_ratio
        )
        if chosen:
            self._frame_index, self._T_odom_camera = frame_index, T_odom_camera
        return chosen

    def restore(self, frame_index: int, T_odom_camera: Pose) -> None:
        """Go on from a frame that was chosen."""
        self._frame_index, self._T_odom_camera = frame_index, T_odom_camera

    def reset(self) -> None:
        """Forget everything: the next frame is a first one."""
        self._T_odom_camera = None

    def _is_due(self, frame_index: int, T_odom_camera: Pose, inlier_ratio: float) -> bool:
        p = self.params
        gap = frame_index - self._frame_index
        if p.policy == "every":
            return gap >= p.every
        assert self._T_odom_camera is not None
        motion = se3.inverse(self._T_odom_camera) @ T_odom_camera
        distance_m = float(np.linalg.norm(motion[:3, 3]))
        angle_rad = float(se3.rotation_angle(motion))
        is_at_rest = distance_m < REST_M and angle_rad < REST_RAD
        return (
            (gap >= p.max_gap and not is_at_rest)
            or inlier_ratio < p.min_inlier_ratio
            or distance_m >= p.distance_m
            or angle_rad >= p.angle_rad
        )
