"""The frames of a session: where odometry had each, where tracking has it, and where the map."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from slam_bof.geometry import spread_correction
from slam_bof.types import LOST, Array, FramePose, Keyframe, Trajectory

__all__ = ["FrameHistory"]


class FrameHistory:
    """Remembers every frame that was processed, in the order they came."""

    def __init__(self, frames: Iterable[FramePose] = ()) -> None:
        self.frames: list[FramePose] = list(frames)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.frames)

    @property
    def last_stamp_s(self) -> float:
        """When the last frame was taken, in seconds."""
        return self.frames[-1].stamp_s if self.frames else -np.inf

    @property
    def n_lost(self) -> int:
        """Of how many frames it is not known where the camera was."""
        return sum(frame.segment == LOST for frame in self.frames)

    def find_last_but_one(self, segment: int) -> None:
        """Note that the last frame but one is of a segment after all, which the last began."""
        self.frames[-2] = replace(self.frames[-2], segment=segment)

    def trajectory(
        self, keyframes: Sequence[Keyframe] = (), T_map_keyframes: Array | None = None
    ) -> Trajectory:
        """Return the sensor's pose of each frame, corrected as its keyframes' are, (K, 4, 4).

        Without keyframes, as tracking has it.
        """
        stamps_s = np.array([frame.stamp_s for frame in self.frames])
        poses = np.array([frame.T_odom_camera for frame in self.frames]).reshape(-1, 4, 4)
        if keyframes:
            poses = spread_correction(
                poses,
                stamps_s,
                np.array([keyframe.frame_index for keyframe in keyframes]),
                np.asarray(T_map_keyframes),
                np.array([frame.segment for frame in self.frames]),
            )
        return Trajectory(stamps_s, poses @ self._T_view_camera())

    def odometry(self) -> Trajectory:
        """Return the sensor's pose of each frame by odometry."""
        poses = np.array([frame.T_odom_raw for frame in self.frames]).reshape(-1, 4, 4)
        stamps_s = np.array([frame.stamp_s for frame in self.frames])
        return Trajectory(stamps_s, poses @ self._T_view_camera())

    def _T_view_camera(self) -> Array:
        views = [frame.T_view_camera for frame in self.frames]
        return np.array([np.eye(4) if T is None else T for T in views]).reshape(-1, 4, 4)
