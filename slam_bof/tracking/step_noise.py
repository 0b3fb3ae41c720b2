"""Learn by how much odometry and alignment err over the step from one keyframe to the next.

A keyframe is aligned with the one before it and with the one before that. Were there no errors,
going round the three would end where it began, so what is left tells the noise of alignment without
any odometry. The difference between odometry's steps and the aligned ones holds the errors of both,
and thus tells those of odometry.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.types import Array

__all__ = ["StepNoise"]

FORGETTING = 0.05
"""Weight of the newest step in what is known of the noise."""
OUTLIER = 3.0
"""Errors greater than usual by this count as this much in what is usual."""
N_CLOSURE = 1.5
"""Variances of an alignment in what is left of going round three keyframes. It would be three if
all errors were independent; those of one keyframe's depth cancel out, but not in its steps."""
PRIOR_STEPS = 4
"""Number of steps that what is assumed at first counts as."""
ALIGNMENT_PRIOR = np.square([0.002, 0.003])
"""Mean square error of alignment at first, in rad^2 and m^2 ..."""
DIFFERENCE_PRIOR = np.square([0.01, 0.02])
"""... and mean square difference between odometry and alignment."""


class StepNoise:
    """Mean square errors of rotation and of translation over a step, each (2,)."""

    def __init__(self) -> None:
        self._n = 0
        self._alignment = ALIGNMENT_PRIOR
        self._difference = DIFFERENCE_PRIOR

    def learn(self, difference: Array, closure: Array | None) -> None:
        """Learn from one step.

        Parameters
        ----------
        difference
            Tangent (6,) from odometry's step to the aligned one.
        closure
            Tangent (6,) of going round three keyframes by alignment; None where two of them have
            too little in common.
        """
        self._n += 1
        weight = max(FORGETTING, 1.0 / (self._n + PRIOR_STEPS))
        self._difference = _updated(self._difference, _mean_square(difference), weight)
        if closure is not None:
            of_one = _mean_square(closure) / N_CLOSURE
            self._alignment = _updated(self._alignment, of_one, weight)

    @property
    def of_alignment(self) -> Array:
        """Covariance (6, 6) of an aligned step, rotation first, in rad^2 and m^2."""
        return np.diag((self._alignment / 3.0).repeat(3))

    @property
    def of_odometry(self) -> Array:
        """Covariance (6, 6) of odometry's step, rotation first, in rad^2 and m^2."""
        excess = np.maximum(self._difference - self._alignment, 0.0)
        return np.diag((excess / 3.0).repeat(3))

    def is_slip(self, difference: Array) -> bool:
        """Tell whether a difference (6,) is greater than noise: then odometry has slipped."""
        return bool((_mean_square(difference) > OUTLIER**2 * self._difference).any())

    def state(self) -> dict[str, Any]:
        """Return what was learnt, as JSON values."""
        return {
            "n": self._n,
            "alignment": self._alignment.tolist(),
            "difference": self._difference.tolist(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state of ``state``."""
        self._n = state["n"]
        self._alignment = np.array(state["alignment"])
        self._difference = np.array(state["difference"])


def _updated(known: Array, found: Array, weight: float) -> Array:
    return known + weight * (np.minimum(found, OUTLIER**2 * known) - known)


def _mean_square(tangent: Array) -> Array:
    """Return the mean squares (2,) of a tangent's (6,) rotation and translation."""
    return np.asarray(np.square(tangent).reshape(2, 3).sum(axis=1))
