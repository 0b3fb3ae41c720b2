"""Weigh odometry against alignment with a keyframe by the noise that each shows.

Alignment does not drift; its errors, of some mm, are independent from frame to frame. Odometry
drifts; from frame to frame it may err by less than alignment (scan to a fine map) or by far more
(scan to a coarse one). Three variances describe this: of odometry's drift in a step, and of the
independent errors of either. They show in the differences between the steps of both: the two noises
make one difference the opposite of the last, drift does not (as in Mehra, IEEE T-AC 1970); and
which of the two noises is the greater shows in how unsteadily each moves. The correction of the
drift then follows a Kalman filter in its steady state, and the pose lies between the corrected
odometry and the alignment.

Where most frames become keyframes, because frames are few, this is not known, since hardly three in
a row are aligned with the same one. ``StepNoise`` then tells whether odometry or alignment errs
more.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.geometry import se3
from slam_bof.tracking.step_noise import (
    FORGETTING,
    SLIP,
    TINY,
    StepNoise,
    products,
    square,
)
from slam_bof.types import Array, Pose

__all__ = ["OdometryFusion"]

N_REFERENCE = 6
"""Frames after which it is known what is usual."""
OUTLIER = 5.0
"""Greater ones than this count as this much in what is usual."""
MAX_WANDER = 0.9
"""Largest share of the drift that is alignment's: a steady drift of odometry looks like that."""


class OdometryFusion:
    """Takes each frame's poses by odometry and by alignment, and says where it is."""

    def __init__(self) -> None:
        self._T_track_odometry: Pose = np.eye(4)
        # Of odometry and of alignment:
        self._poses: Array | None = None  # (2, 4, 4) of the last frame
        self._steps: Array | None = None  # (2, 6) since the one before
        self._last: Array | None = None  # (2, 4, 4) of the last frame, by odometry and as fused
        self._n = 0
        self._step_noise = StepNoise()
        # Of rotation and of translation, each (2,):
        self._difference = np.full(2, TINY)  # mean square between the steps of both
        self._after = np.zeros(2)  # the same, of one and the next
        self._unsteady = np.zeros(2)  # mean square change of step, of alignment less odometry's

    def restart(self, T_odometry: Pose, T_track: Pose) -> None:
        """Take a frame's pose (4, 4) for what it is, and odometry's steps from there on."""
        self._T_track_odometry = _rigid(T_track @ se3.inverse(T_odometry))
        self._poses = self._steps = self._last = None

    def carry(self, T: Pose) -> None:
        """Move the whole track by ``T`` (4, 4)."""
        self._T_track_odometry = _rigid(T @ self._T_track_odometry)
        if self._poses is not None:
            self._poses = np.stack([self._poses[0], T @ self._poses[1]])
        if self._last is not None:
            self._last = np.stack([self._last[0], T @ self._last[1]])

    def change_reference(self) -> None:
        """Frames are aligned with another keyframe from now on, which shifts all of them."""
        self._poses = self._steps = None

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it; of a frame aligned with a new keyframe."""
        return {
            "T_track_odometry": self._T_track_odometry.tolist(),
            "n": self._n,
            "difference": self._difference.tolist(),
            "after": self._after.tolist(),
            "unsteady": self._unsteady.tolist(),
            "last": None if self._last is None else self._last.tolist(),
            "step_noise": self._step_noise.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._poses = self._steps = None
        # Maps that were saved before steps between keyframes were compared do not have them.
        last = state.get("last")
        self._last = None if last is None else np.array(last)
        self._n = state["n"]
        self._T_track_odometry = np.array(state["T_track_odometry"])
        self._difference = np.array(state["difference"])
        self._after = np.array(state["after"])
        self._unsteady = np.array(state["unsteady"])
        self._step_noise = StepNoise(state.get("step_noise"))

    def predict(self, T_odometry: Pose) -> Pose:
        """Return the pose (4, 4) of a frame as far as odometry tells."""
        return self._T_track_odometry @ T_odometry

    def fuse(self, T_odometry: Pose, T_aligned: Pose) -> Pose:
        """Return the pose (4, 4) of a frame that has been aligned too."""
        T_predicted = self.predict(T_odometry)
        poses = np.stack([T_odometry, T_aligned])
        before = poses if self._poses is None else self._poses
        moved = se3.inverse(np.stack([T_predicted, *before])) @ np.stack([T_aligned, *poses])
        tangents = se3.log(moved)
        off, steps = tangents[0], tangents[1:]
        if self._steps is not None:
            self._learn(self._steps, steps)
        self._steps = None if self._poses is None else steps
        self._poses = poses
        of_drift, of_pose = self._gains()
        # As long as nothing is known, anything is a slip.
        if (square(off) > SLIP**2 * self._difference).any():
            of_drift = of_pose = np.ones(2)
        if self._last is None:
            self._step_noise.interrupt()
        else:
            moved = np.stack([T_odometry, T_aligned])
            self._step_noise.learn(se3.log(se3.inverse(self._last) @ moved))
            if self._n <= N_REFERENCE and self._step_noise.is_known:
                of_drift = of_pose = self._step_noise.gain(off)
        T_corrected, T_fused = T_predicted @ se3.exp(
            np.stack([off * of_drift.repeat(3), off * of_pose.repeat(3)])
        )
        self._T_track_odometry = _rigid(T_corrected @ se3.inverse(T_odometry))
        self._last = np.stack([T_odometry, T_fused])
        return np.asarray(T_fused)

    def _learn(self, before: Array, now: Array) -> None:
        """Learn from the last two steps, each (2, 6) by odometry and by alignment."""
        first, second = before[1] - before[0], now[1] - now[0]
        unsteady = square(now[1] - before[1]) - square(now[0] - before[0])
        self._n += 1
        is_reference_known = self._n > N_REFERENCE
        most = OUTLIER**2 * self._difference if is_reference_known else np.full(2, np.inf)
        weight = max(FORGETTING, 1.0 / (self._n + 1))
        squares = 0.5 * (square(first) + square(second))
        difference = np.minimum(squares, most)
        after = np.clip(products(first, second), -most, most)
        unsteady = np.clip(unsteady, -6.0 * most, 6.0 * most)
        self._difference = self._difference + weight * (difference - self._difference)
        self._after = self._after + weight * (after - self._after)
        self._unsteady = self._unsteady + weight * (unsteady - self._unsteady)

    def _gains(self) -> tuple[Array, Array]:
        """Return how far to go to the alignment, (2,) for the drift and (2,) for the pose.

        With noises a of alignment and b of odometry, drift q of odometry a step, and w by which
        alignment wanders, as where a sensor errs alike in frames that follow each other, mean
        squares are 2 (a + b) + q + w of differences, -(a + b) of one by the next, and
        6 a + 2 w - (6 b + 2 q) of the changes of step, alignment's less odometry's. These do not
        tell all four; w is the least that agrees with them.
        """
        noise = np.maximum(-self._after, TINY)
        drift = np.maximum(self._difference - 2.0 * noise, 0.0)
        excess = self._unsteady - 6.0 * noise + 2.0 * drift
        drift -= np.clip(excess / 4.0, 0.0, MAX_WANDER * drift)
        of_drift = 2.0 / (1.0 + np.sqrt(1.0 + 4.0 * noise / np.maximum(drift, TINY)))
        of_odometry = 0.5 - (self._unsteady + 2.0 * drift) / (12.0 * noise)
        of_pose = of_drift + (1.0 - of_drift) * np.clip(of_odometry, 0.0, 1.0)
        return of_drift, of_pose


def _rigid(T: Pose) -> Pose:
    """Return the transform with its rotation a true one, lest rounding adds up."""
    return se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
