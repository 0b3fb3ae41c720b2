"""Weigh odometry against alignment with the last keyframe, direction by direction.

A Kalman filter of the pose relative to the keyframe. Each step of odometry adds to its covariance,
each alignment takes from it, more along directions that the surfaces hold well than along those
that they hold weakly. The covariance of an alignment is known from its points
(``geometry.PrincipalDirections``). That of odometry's steps is either given, or learnt along each
principal direction from how far alignments are from where the filter expects them (as in Mehra,
IEEE T-AC 1970), as far as that is more than an alignment may be off itself.

Odometry counts as exact until it shows that it is not. Where it tells nothing of the motion any
more (``odometry_skill``), the camera is expected to stand still instead.

Some sensors err alike over large parts of a view, as that of a phone does; their alignments are
less precise than their points tell. That shows where odometry moves steadily and alignment does
not (``step_steadiness``).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.geometry import se3
from slam_bof.tracking.odometry_skill import OdometrySkill
from slam_bof.tracking.step_steadiness import StepSteadiness
from slam_bof.types import Array, Pose

__all__ = ["OdometryFusion"]

FORGETTING = 0.05
"""Weight of the newest frame in what is known of odometry: about a second of a camera."""
N_REFERENCE = 6
"""Frames after which it is known what is usual."""
OUTLIER = 5.0
"""An alignment that is off by more than this multiple of what is expected is a slip of odometry, or
is wrong. It counts as this much in what is learnt."""
SLIP_GIVEN = 0.2
"""A slip of odometry that says itself how precise it is moves by more than this, in m or rad.
Smaller differences are rather those of wrong alignments, or of clocks and calibrations."""
MARGIN = 2.0
"""Odometry that errs in a step by no more than this multiple of an alignment's variance is left
alone."""
RESTART_VARIANCE = 0.1**2
"""Of a pose after a restart, in rad^2 and m^2."""
MIN_INFORMATION = 1e-6
"""Directions with a smaller share of the largest information are open."""


class OdometryFusion:
    """Takes each frame's poses by odometry and by alignment, and says where it is.

    Attributes
    ----------
    covariance
        (6, 6) of the tangent of the last frame's pose relative to the keyframe, rotation first, in
        rad^2 and m^2.
    """

    def __init__(self) -> None:
        self.covariance: Array = np.zeros((6, 6))
        self._T_track_odometry: Pose = np.eye(4)
        self._is_aligned = False  # with this keyframe, any frame
        self._last: Array | None = None  # (2, 4, 4) of the last frame, by odometry and as fused
        self._is_last_aligned = False
        self._step_covariance = np.zeros((6, 6))  # of odometry, as last learnt
        self._n = 0
        self._squares = np.ones(6)
        """Mean squares of odometry's step and alignment along principal directions, the best one
        first, in terms of the variance that the points of an alignment tell."""
        self._skill = OdometrySkill()
        self._steadiness = StepSteadiness()

    def restart(self, T_odometry: Pose, T_track: Pose) -> None:
        """Take a frame's pose (4, 4) for what it is, and odometry's steps from there on."""
        self._T_track_odometry = _rigid(T_track @ se3.inverse(T_odometry))
        self.covariance = RESTART_VARIANCE * np.eye(6)
        self._set_last(T_odometry, T_track)

    def change_keyframe(self) -> None:
        """Make the last frame the keyframe that the next ones are aligned with."""
        self.covariance = np.zeros((6, 6))
        self._is_aligned = False

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it; of a frame that is a new keyframe."""
        return {
            "T_track_odometry": self._T_track_odometry.tolist(),
            "last": None if self._last is None else self._last.tolist(),
            "is_last_aligned": self._is_last_aligned,
            "skill": self._skill.state(),
            "n": self._n,
            "squares": self._squares.tolist(),
            "step_covariance": self._step_covariance.tolist(),
            **self._steadiness.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        self.change_keyframe()
        self._T_track_odometry = np.array(state["T_track_odometry"])
        if "squares" not in state:
            return  # a map that was saved before directions were weighed one by one
        last = state["last"]
        self._last = None if last is None else np.array(last)
        self._is_last_aligned = state.get("is_last_aligned", last is not None)
        if "skill" in state:  # else it was saved before these were known
            self._skill.restore(state["skill"])
            self._step_covariance = np.array(state["step_covariance"])
        self._n, self._squares = state["n"], np.array(state["squares"])
        self._steadiness.restore(state)

    def predict(self, T_odometry: Pose) -> Pose:
        """Return the pose (4, 4) of a frame before it is aligned.

        That is where odometry has it, or that of the last frame where odometry tells nothing and
        moves less steadily than alignment.
        """
        if (
            self._last is not None
            and self._skill.is_none
            and self._steadiness.alignment_is_steadier
        ):
            return np.asarray(self._last[1])
        return self._T_track_odometry @ T_odometry

    def skip(self, T_odometry: Pose, step_covariance: Array | None) -> None:
        """Take a frame that is not aligned, with the covariance (6, 6) of odometry's step to it."""
        if step_covariance is None:
            step_covariance = self._step_covariance
        self.covariance = self.covariance + step_covariance
        T_predicted = self.predict(T_odometry)
        self._T_track_odometry = _rigid(T_predicted @ se3.inverse(T_odometry))
        self._set_last(T_odometry, T_predicted)

    def fuse(
        self,
        T_odometry: Pose,
        T_aligned: Pose,
        information: Array,
        step_covariance: Array | None = None,
    ) -> Pose:
        """Return the pose (4, 4) of a frame that has been aligned too.

        Parameters
        ----------
        T_odometry, T_aligned
            (4, 4) each, the pose by odometry and by alignment.
        information
            (6, 6) of the tangent of the alignment, zero along directions that are open.
        step_covariance
            (6, 6) of the odometry's step to this frame; learnt if it is None.
        """
        T_predicted = self.predict(T_odometry)
        whiten, unwhiten = _whitening(information)
        innovation = whiten @ se3.log(se3.inverse(T_predicted) @ T_aligned)
        if len(innovation) > 0 and self._last is not None and self._is_last_aligned:
            steps = se3.log(se3.inverse(self._last) @ np.stack([T_odometry, T_aligned]))
            self._steadiness.learn(steps, whiten, innovation)
        else:
            self._steadiness.interrupt()
        variance = self._steadiness.alignment_variance
        is_given = step_covariance is not None
        if step_covariance is None:
            before = whiten @ self.covariance @ whiten.T
            of_step = self._learn(innovation, np.diag(before), variance)
            step_covariance = self._step_covariance = (unwhiten * of_step) @ unwhiten.T
            self._learn_skill(T_odometry, T_aligned, is_held=len(innovation) == 6)
        covariance = self.covariance + step_covariance
        expected = whiten @ covariance @ whiten.T + variance * np.eye(len(innovation))
        gain = np.linalg.solve(expected, whiten @ covariance).T
        if innovation @ np.linalg.solve(expected, innovation) > OUTLIER**2 * len(innovation):
            share = np.trace(whiten @ gain) / len(innovation)
            size = float(np.linalg.norm(unwhiten @ innovation))
            is_slip = share > 0.5 or self._can_slip(size, is_given=is_given)
            gain = unwhiten if is_slip else np.zeros_like(gain)
        self._is_aligned = True
        self.covariance = covariance - gain @ whiten @ covariance
        T_fused = T_predicted @ se3.exp(gain @ innovation)
        self._T_track_odometry = _rigid(T_fused @ se3.inverse(T_odometry))
        self._set_last(T_odometry, T_fused, is_aligned=True)
        return np.asarray(T_fused)

    def _set_last(self, T_odometry: Pose, T_track: Pose, *, is_aligned: bool = False) -> None:
        self._last = np.stack([T_odometry, T_track])
        self._is_last_aligned = is_aligned
        if not is_aligned:
            self._steadiness.interrupt()

    def _can_slip(self, size: float, *, is_given: bool) -> bool:
        """Return whether it is odometry that is wrong where it differs by far from an alignment.

        Where nothing else has been aligned with this keyframe, it may be odometry that holds.
        """
        if is_given:
            return self._is_aligned and size > SLIP_GIVEN
        return self._is_aligned or self._n <= N_REFERENCE

    def _learn_skill(self, T_odometry: Pose, T_aligned: Pose, *, is_held: bool) -> None:
        """Learn how far odometry errs, from a frame that is held in all directions."""
        if self._last is None or not is_held:
            return
        step = se3.log(se3.inverse(self._last[0]) @ T_odometry)
        error = se3.log(se3.inverse(self._T_track_odometry @ T_odometry) @ T_aligned)
        self._skill.learn(step, error)

    def _learn(self, innovation: Array, expected: Array, variance: float) -> Array:
        """Learn from a whitened innovation (n,); return the variances (n,) of odometry's step.

        ``expected`` (n,) are the variances of the pose before that step, and ``variance`` is that
        of alignment.
        """
        self._n += 1
        n = len(innovation)
        known = self._squares[:n]
        found = innovation**2 - expected
        if self._n > N_REFERENCE:
            found = np.minimum(found, OUTLIER**2 * np.maximum(known, variance))
        self._squares = np.append(known + FORGETTING * (found - known), self._squares[n:])
        return np.maximum(self._squares[:n] - (1.0 + MARGIN) * variance, 0.0)


def _whitening(information: Array) -> tuple[Array, Array]:
    """Return what whitens tangents, (n, 6), for n principal directions, and its inverse (6, n).

    The direction that is held best comes first.
    """
    values, axes = np.linalg.eigh(information)
    n_open = int(np.count_nonzero(values <= MIN_INFORMATION * max(values[-1], 0.0)))
    held, sigmas = axes[:, n_open:][:, ::-1], values[n_open:][::-1] ** -0.5
    return held.T / sigmas[:, None], held * sigmas


def _rigid(T: Pose) -> Pose:
    """Return the transform with its rotation a true one, lest rounding adds up."""
    return se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
