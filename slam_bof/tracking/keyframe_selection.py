"""Which frames the map keeps."""

from __future__ import annotations

from typing import Literal

import numpy as np
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Params, Pose

__all__ = ["KeyframeParams", "KeyframeSelector"]


class KeyframeParams(Params):
    """Policy ``motion`` keeps a frame that moved enough; ``every`` the paper's k-th frame."""

    policy: Literal["motion", "every"] = "motion"
    distance_m: float = Field(0.12, gt=0, description="motion: a frame this far from the last")
    angle_rad: float = Field(0.2, gt=0, description="motion: or turned this much")
    max_gap: int = Field(
        10, gt=0, description="motion: at most so many frames from one to the next"
    )
    min_seen: float = Field(0.4, le=1, description="motion: or that sees less of the same")
    every: int = Field(10, gt=0, description="every: each k-th frame")


class KeyframeSelector:
    """Says of each frame in turn whether it becomes a keyframe; the first always does."""

    def __init__(self, params: KeyframeParams) -> None:
        self.params = params
        self._frame_index = -1
        self._T_odom_camera: Pose | None = None

    def select(self, frame_index: int, T_odom_camera: Pose, *, seen: float = float("nan")) -> bool:
        """Decide for one frame, and remember it if the answer is yes.

        ``seen`` is the share of its points that the last one chosen sees too, NaN if that is not
        known.
        """
        chosen = self._T_odom_camera is None or self._is_due(frame_index, T_odom_camera, seen)
        if chosen:
            self._frame_index, self._T_odom_camera = frame_index, T_odom_camera
        return chosen

    def restore(self, frame_index: int, T_odom_camera: Pose) -> None:
        """Go on from a frame that was chosen."""
        self._frame_index, self._T_odom_camera = frame_index, T_odom_camera

    def reset(self) -> None:
        """Forget everything: the next frame is a first one."""
        self._T_odom_camera = None

    def _is_due(self, frame_index: int, T_odom_camera: Pose, seen: float) -> bool:
        p = self.params
        gap = frame_index - self._frame_index
        if p.policy == "every":
            return gap >= p.every
        assert self._T_odom_camera is not None
        motion = se3.inverse(self._T_odom_camera) @ T_odom_camera
        return (
            gap >= p.max_gap
            or seen < p.min_seen
            or float(np.linalg.norm(motion[:3, 3])) >= p.distance_m
            or float(se3.rotation_angle(motion)) >= p.angle_rad
        )
