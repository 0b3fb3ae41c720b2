"""The poses of all frames of a session: from odometry, tracking and the map."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3, spread_correction
from slam_bof.types import LOST, Array, FramePose, Keyframe, Trajectory

__all__ = ["FrameHistory"]

TIE = 1e-6
"""Relative difference of two distances from the map that counts as none: last digits of the map,
which depend on where a call was interrupted, must not decide between odometry and tracking."""


class FrameHistory:
    """Stores the poses of all processed frames in order."""

    def __init__(self, frames: Iterable[FramePose] = ()) -> None:
        self.frames: list[FramePose] = list(frames)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.frames)

    @property
    def last_stamp_s(self) -> float:
        """Time of the last frame in seconds, or minus infinity if there is none."""
        return self.frames[-1].stamp_s if self.frames else -np.inf

    @property
    def n_lost(self) -> int:
        """Number of frames whose pose is unknown."""
        return sum(frame.segment == LOST for frame in self.frames)

    def assign_previous(self, segment: int) -> None:
        """Assign the frame before the last one to a segment that began with the last one."""
        self.frames[-2] = replace(self.frames[-2], segment=segment)

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present frames; see ``core.Checkpoint``."""
        n = max(len(self) - 2, 0)  # only the last two may be replaced
        last = self.frames[n:]

        def restore() -> None:
            self.frames[n:] = last

        return restore

    def trajectory(
        self, keyframes: Sequence[Keyframe] = (), T_map_keyframes: Array | None = None
    ) -> Trajectory:
        """Return the sensor pose of each frame, corrected by the keyframe poses (K, 4, 4).

        Between keyframes, frames move as in odometry or as in tracking, whichever is nearer to the
        map from keyframe to keyframe; as in odometry where both are equally near, as with exact
        odometry. Without keyframes the poses are those of tracking.
        """
        stamps_s = np.array([frame.stamp_s for frame in self.frames])
        poses = np.array([frame.T_odom_camera for frame in self.frames]).reshape(-1, 4, 4)
        if keyframes:
            raw = np.array([frame.T_odom_raw for frame in self.frames])
            at = np.array([keyframe.frame_index for keyframe in keyframes])
            segments = np.array([frame.segment for frame in self.frames])
            T_map_keyframes = np.asarray(T_map_keyframes)
            off, off_raw = (
                _mean_difference(T[at], T_map_keyframes, segments[at]) for T in (poses, raw)
            )
            follows_odometry = off_raw <= (1.0 + TIE) * off
            poses = spread_correction(
                raw if follows_odometry else poses, stamps_s, at, T_map_keyframes, segments
            )
        return Trajectory(stamps_s, poses @ self._T_view_camera())

    def odometry(self) -> Trajectory:
        """Return the sensor pose of each frame from odometry."""
        poses = np.array([frame.T_odom_raw for frame in self.frames]).reshape(-1, 4, 4)
        stamps_s = np.array([frame.stamp_s for frame in self.frames])
        return Trajectory(stamps_s, poses @ self._T_view_camera())

    def _T_view_camera(self) -> Array:
        views = [frame.T_view_camera for frame in self.frames]
        return np.array([np.eye(4) if T is None else T for T in views]).reshape(-1, 4, 4)


def _mean_difference(poses: Array, T_map_keyframes: Array, segments: NDArray[np.intp]) -> float:
    """Return by how much the steps of two tracks (K, 4, 4) differ, in m; 0 if there are none."""
    steps, map_steps = (se3.inverse(T[:-1]) @ T[1:] for T in (poses, T_map_keyframes))
    off = (se3.inverse(map_steps) @ steps)[np.diff(segments) == 0]
    return float(np.linalg.norm(off[:, :3, 3], axis=1).mean()) if len(off) else 0.0
