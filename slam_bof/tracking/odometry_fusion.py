"""Fuse odometry with alignment to a keyframe, direction by direction, by a Kalman filter.

The filter's state is by how much the odometry has erred since the last keyframe, in the tangent of
the camera's pose. Odometry's error grows with the way; each alignment measures it with the
covariance that its surfaces allow, which is next to nothing along open directions. What odometry
errs by, for each metre and along each axis of the camera, is given with it or is learnt: it is
what its disagreement with alignments exceeds their covariance by. So an exact odometry stays as it
is, and one that drifts is corrected where the surfaces hold, and only there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["OdometryFusion"]

DRIFT = np.repeat([0.003, 0.006], 3)
"""Odometry's errors for each metre, rad and m, as long as nothing is known of them."""
MIN_DRIFT, MAX_DRIFT = 0.02 * DRIFT, 300.0 * DRIFT
LENGTH_M = 1.0
"""Over such a way errors of odometry are much the same; over longer ones they are independent."""
TURN_M = 0.4
"""A radian turned counts as so many metres."""
STILL_M = 0.001
"""And each frame as so many, also of a camera that stands still."""
WINDOW_M = 1.5
"""Way over which odometry and alignments are compared: over less, drift is lost in their noise."""
LEARNING_M = 0.5
"""Way over which odometry's errors are learnt."""
FRESH_M = 0.05
"""Alignments from places nearer than this to each other err alike: the nearer, the less new."""
MIN_FRESH = 0.1
ISOTROPY = 0.25
"""Variance along an axis is at least this share of the greatest one ..."""
LEVER_M = 2.0
"""... and that of turns this share of what moves points so far away as much."""
DRIFT_SIGMAS = 2.5
"""Odometry must be off by more standard errors of the alignments to have drifted."""
MAX_GROWTH = 16.0
"""Of what is known of their variance, at most, from one keyframe to the next."""
SLIP_SIGMAS = 8.0
"""Disagreement by more standard deviations is a slip of odometry."""
MAX_VARIANCE = 1.0
"""Of an alignment along open directions, rad^2 and m^2."""


class _Leg(NamedTuple):
    """From one keyframe to the next: by odometry, by alignment, and the latter's covariance."""

    T_odometry: Pose
    T_aligned: Pose
    noise: Array
    way_m: float


class OdometryFusion:
    """Takes each frame's pose by odometry, and by alignment where there is one."""

    def __init__(self) -> None:
        self._drift = np.square(DRIFT)
        self._T_last_odometry: Pose = np.eye(4)
        self._T_last_track: Pose = np.eye(4)
        self._step_m = 0.0
        self._legs: list[_Leg] = []
        self._leg: _Leg | None = None
        self._T_keyframe = self._T_reference_odometry = np.eye(4)
        self._way_m = 0.0
        self._is_given = False
        self._covariance = np.zeros((6, 6))

    @property
    def covariance(self) -> Array:
        """Of the last pose since the last keyframe: (6, 6), the pose's tangent, rotation first."""
        return self._covariance

    @property
    def drift(self) -> Array:
        """Odometry's errors for each metre as learnt: (6,) rad and m, along the camera's axes."""
        return np.asarray(np.sqrt(self._drift))

    def restart(self, T_odometry: Pose, T_track: Pose, covariance: Array | None = None) -> None:
        """Take a frame's pose (4, 4) for what it is, with its covariance since the keyframe."""
        self._T_last_odometry, self._T_last_track = T_odometry, _rigid(T_track)
        self._legs = []
        self._restart_reference()
        if covariance is not None:
            self._covariance = covariance

    def change_reference(self) -> None:
        """Count errors from the last frame on, which is the keyframe now."""
        self._legs = [*self._legs, self._leg] if self._leg is not None else []
        if self._legs and not self._is_given:
            self._learn()
        self._restart_reference()

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it; of a frame that became a keyframe."""
        return {
            "T_odometry": self._T_last_odometry.tolist(),
            "T_track": self._T_last_track.tolist(),
            "drift": self._drift.tolist(),
            "legs": [
                [leg.T_odometry.tolist(), leg.T_aligned.tolist(), leg.noise.tolist(), leg.way_m]
                for leg in self._legs
            ],
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self._drift = np.array(state["drift"])
        self._T_last_odometry = np.array(state["T_odometry"])
        self._T_last_track = np.array(state["T_track"])
        self._restart_reference()
        self._legs = [
            _Leg(np.array(T_odometry), np.array(T_aligned), np.array(noise), way_m)
            for T_odometry, T_aligned, noise, way_m in state["legs"]
        ]

    def predict(self, T_odometry: Pose, covariance: Array | None = None) -> Pose:
        """Return the pose (4, 4) of the next frame as far as odometry tells.

        ``covariance`` (6, 6) is odometry's own of the step since the last frame, rotation first
        along the camera's axes, if it has one.
        """
        step = se3.inverse(self._T_last_odometry) @ T_odometry
        self._step_m = float(
            np.linalg.norm(step[:3, 3]) + TURN_M * se3.rotation_angle(step) + STILL_M
        )
        back = se3.adjoint(se3.inverse(step))
        self._way_m += self._step_m
        self._covariance = back @ self._covariance @ back.T
        if covariance is None:
            growth = np.diag(_spread(self._drift)) * (LENGTH_M * self._step_m)
        else:
            growth = covariance
        self._covariance = self._covariance + growth
        self._is_given = covariance is not None
        self._T_reference_odometry = self._T_reference_odometry @ step
        self._leg = None
        self._T_last_track = _rigid(self._T_last_track @ step)
        self._T_last_odometry = T_odometry
        return self._T_last_track

    def fuse(self, T_aligned: Pose, information: Array) -> Pose:
        """Return the pose (4, 4) of the frame just predicted, which has been aligned too.

        ``information`` (6, 6) is of the tangent of ``T_aligned``, rotation first, in rad and m.
        """
        noise = _covariance_of(information)
        T_keyframe_aligned = se3.inverse(self._T_keyframe) @ T_aligned
        self._leg = _Leg(self._T_reference_odometry, T_keyframe_aligned, noise, self._way_m)
        fresh = float(np.clip(self._step_m / FRESH_M, MIN_FRESH, 1.0))
        off = se3.log(se3.inverse(self._T_last_track) @ T_aligned)
        expected = self._covariance + noise
        if off @ np.linalg.solve(expected, off) > SLIP_SIGMAS**2:
            # Odometry slipped: nothing is left of what it said.
            self._covariance = self._covariance + MAX_VARIANCE * np.eye(6)
            fresh = 1.0
        gain = np.linalg.solve(self._covariance + noise / fresh, self._covariance).T
        self._T_last_track = _rigid(self._T_last_track @ se3.exp(gain @ off))
        keep = np.eye(6) - gain
        covariance = keep @ self._covariance @ keep.T + gain @ (noise / fresh) @ gain.T
        self._covariance = 0.5 * (covariance + covariance.T)
        return self._T_last_track

    def _learn(self) -> None:
        """Learn odometry's errors from what it is off by over the last legs."""
        T_odometry, T_aligned = np.eye(4), np.eye(4)
        noise = np.zeros((6, 6))
        way_m = 0.0
        n = 0
        for leg in reversed(self._legs):
            # From the newest leg back: all in the frame of the newest keyframe.
            back = se3.adjoint(se3.inverse(T_aligned))
            noise = noise + back @ leg.noise @ back.T
            T_odometry, T_aligned = leg.T_odometry @ T_odometry, leg.T_aligned @ T_aligned
            way_m += leg.way_m
            n += 1
            if way_m > WINDOW_M:
                break
        self._legs = self._legs[-n:]
        off = se3.log(se3.inverse(T_odometry) @ T_aligned)
        reach = way_m * min(way_m, LENGTH_M)
        variance, squares = np.diag(noise), np.square(off)
        most = MAX_GROWTH * self._drift
        # Windows overlap, so that chance lasts: only what is beyond it counts as drift.
        is_drift = squares > np.square(DRIFT_SIGMAS) * variance
        drift = np.where(is_drift, np.minimum((squares - variance) / reach, most), 0.0)
        # Where alignments err by more than odometry can have, nothing is learnt.
        signal = np.maximum(self._drift * reach, np.abs(squares - variance))
        rate = 1.0 - np.exp(-self._way_m / LEARNING_M)
        weight = rate * np.square(signal / (signal + variance))
        self._drift = np.clip(
            self._drift + weight * (drift - self._drift), np.square(MIN_DRIFT), np.square(MAX_DRIFT)
        )

    def _restart_reference(self) -> None:
        self._covariance = np.zeros((6, 6))
        self._way_m = 0.0
        self._T_keyframe = self._T_last_track
        self._T_reference_odometry = np.eye(4)
        self._leg = None
        self._is_given = False


def _spread(drift: Array) -> Array:
    """Let no variance (6,) fall far below that of its neighbours: where odometry slides, it turns.

    What is seen of an error along one combination of axes else is taken for the least known one.
    """
    turns, shifts = drift[:3], drift[3:]
    turns = np.maximum(turns, ISOTROPY * max(turns.max(), shifts.max() / LEVER_M**2))
    return np.concatenate([turns, np.maximum(shifts, ISOTROPY * shifts.max())])


def _covariance_of(information: Array) -> Array:
    """Invert information (6, 6), what is open to ``MAX_VARIANCE``."""
    return np.asarray(np.linalg.inv(information + np.eye(6) / MAX_VARIANCE))


def _rigid(T: Pose) -> Pose:
    """Return the transform with its rotation a true one, lest rounding adds up."""
    return se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
