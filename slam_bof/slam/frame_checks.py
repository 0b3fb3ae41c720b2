"""Checks of the frames and poses that a loop closer is given."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.datasets import doubts_of_depth
from slam_bof.errors import FrameError, FrameWarning
from slam_bof.geometry import se3
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose, SensorParams

__all__ = ["FrameChecks", "checked_pose", "rotation_first"]

MAX_JUMP_S = 86_400.0
"""A stamp farther ahead of the last one than this is refused, unless the next frame confirms it."""
N_SAMPLES = 5
"""Number of frames whose depth is looked at, to tell a wrong unit from a hand before the camera."""
SAMPLE_STRIDE = 5
"""Every so many frames with depth one of them."""
MAX_STEP_S = 5.0
"""Mean step between the first frames above which stamps are hardly in seconds. In milliseconds, 30
frames a second are 33 apart."""
SAMPLED_PX = 4
"""Every so many pixels along rows and columns."""
CALLER = 6
"""Level of the stack at which ``LoopCloser.process`` is called: from there it is warned."""


class FrameChecks:
    """Checks each frame against those before: they are of one camera, and time goes on.

    ``camera`` has the intrinsics of the first frame, None before it. Depth most of which lies
    outside of the range of the ``sensor``, in the first frames, is warned of, and so are stamps too
    far apart to be in seconds.
    """

    def __init__(self, sensor: SensorParams | None = None) -> None:
        self.camera: Intrinsics | None = None
        self._refused_stamp_s = -np.inf
        self._sensor = sensor
        self._samples: list[NDArray[np.float32]] = []
        self._n_frames = 0  # with depth
        self._first_s = -np.inf  # of these

    def check(self, frame: DepthFrame, last_stamp_s: float) -> DepthFrame:
        """Return the frame with the camera of the first frame; ``FrameError`` if it does not fit.

        ``last_stamp_s`` is the stamp of the frame before, minus infinity if there is none.
        """
        self._check_stamp(frame.stamp_s, last_stamp_s)
        camera = self.camera or frame.intrinsics
        if not frame.intrinsics.is_close(camera):
            raise FrameError(f"frames must all be of {camera}, got one of {frame.intrinsics}")
        self.camera = camera
        self._sample(frame)
        return frame if frame.intrinsics == camera else replace(frame, intrinsics=camera)

    def _sample(self, frame: DepthFrame) -> None:
        """Look at a few of the first frames; warn once if a unit is in doubt."""
        if len(self._samples) == N_SAMPLES:
            return
        depth_m = frame.depth_m(SAMPLED_PX)
        if not depth_m.any():
            return
        if self._n_frames == 0:
            self._first_s = frame.stamp_s
        if self._n_frames % SAMPLE_STRIDE == 0:
            self._samples.append(depth_m[depth_m > 0])
            if len(self._samples) == N_SAMPLES:
                for doubt in self._doubts(frame.stamp_s):
                    warnings.warn(doubt, FrameWarning, stacklevel=CALLER)
        self._n_frames += 1

    def _doubts(self, stamp_s: float) -> list[str]:
        """Return what is implausible about the frames up to one of this time."""
        of_depth = doubts_of_depth(np.concatenate(self._samples), self._sensor)
        expected = "DepthFrame takes uint16 in millimetres or floats in metres"
        doubts = [f"{doubt}; {expected}" for doubt in of_depth]
        step_s = (stamp_s - self._first_s) / self._n_frames
        if step_s > MAX_STEP_S:
            doubts.append(f"frames are {step_s:.3g} s apart: are time stamps in seconds?")
        return doubts

    def _check_stamp(self, stamp_s: float, last_s: float) -> None:
        """Refuse a stamp that does not increase, or a jump that no frame before confirms."""
        if not last_s < stamp_s < np.inf:
            raise FrameError(f"time stamps must increase, got {stamp_s} s after {last_s} s")
        is_confirmed = 0.0 < stamp_s - self._refused_stamp_s <= MAX_JUMP_S
        if last_s > -np.inf and stamp_s - last_s > MAX_JUMP_S and not is_confirmed:
            self._refused_stamp_s = stamp_s
            raise FrameError(
                f"time stamps must be in seconds, got {stamp_s} s more than a day after {last_s} s"
            )


def checked_pose(
    T: ArrayLike, frame_index: int, stamp_s: float, *, name: str = "T_odom_camera"
) -> Pose:
    """Return a copy of a pose as float64 (4, 4); ``FrameError`` if it is no rigid transform."""
    try:
        return se3.checked_pose(T)
    except ValueError as error:
        raise FrameError(f"{name} of frame {frame_index}, at {stamp_s} s: {error}") from None


def rotation_first(covariance: ArrayLike, frame_index: int) -> Array:
    """Check a covariance in the order of ``nav_msgs/Odometry``; return it with rotation first."""
    place = f"covariance of frame {frame_index}"
    try:
        found = np.asarray(covariance)
    except ValueError as error:
        raise FrameError(f"{place}: {error}") from None
    if found.size != 36 or found.dtype.kind not in "fiu":
        kind = f"an array {found.shape}" if found.dtype.kind in "fiu" else f"{found.dtype}"
        raise FrameError(f"{place}: found {kind}, expected (6, 6) numbers")
    found = found.reshape(6, 6).astype(np.float64)
    if not np.isfinite(found).all() or np.abs(found - found.T).max() > 1e-6 * np.abs(found).max():
        raise FrameError(f"{place}: expected 36 finite numbers, symmetric")
    if np.linalg.eigvalsh(found)[0] < -1e-9 * max(float(np.trace(found)), 1e-30):
        raise FrameError(f"{place}: expected no negative variance in any direction")
    return se3.exchange_blocks(found)
