"""Whether odometry or alignment errs more from frame to frame, each aligned with any keyframe."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.types import Array

__all__ = ["FORGETTING", "SLIP", "TINY", "StepNoise", "products", "square"]

FORGETTING = 0.05
"""Weight of the newest frame in what is known of the noise: about a second of a camera."""
SLIP = 3.0
"""Differences greater than usual by this factor are slips of odometry or of alignment."""
N_STEPS = 12
"""Steps after which it is known which errs more."""
TINY = 1e-12
"""Variances, m^2 and rad^2, that are nothing."""
PERSISTENT = 0.5
"""If this share of a difference is found again in the next step, it is odometry's: odometry follows
the motion too little or too much, as scan matching does when it is stuck."""


def products(a: Array, b: Array) -> Array:
    """Return the dot products of two tangents (6,), of their rotations and translations: (2,)."""
    return np.asarray((a * b).reshape(2, 3).sum(axis=1))


def square(tangent: Array) -> Array:
    """Return the squares of the lengths of a tangent's rotation and translation, (2,)."""
    return products(tangent, tangent)


class StepNoise:
    """Takes steps from frame to frame, each by odometry and by alignment.

    If each frame is aligned with the one before, the errors of steps are independent. With
    variances q of odometry's and a of alignment's, mean squares are a + q of differences and
    2 (a - q) of the changes of step, alignment's less odometry's, in which the motion itself
    cancels out. Mean products of a difference and the next are 0. If a keyframe serves for more
    frames, errors of poses count too, and what is the more precise of the two seems even more so.
    """

    def __init__(self, state: dict[str, Any] | None = None) -> None:
        known = state or {}
        self._n: int = known.get("n", 0)
        # Of rotation and of translation, each (2,), mean squares as above:
        self._difference, self._after, self._unsteady = (
            np.array(known.get(name, [0.0, 0.0])) for name in ("difference", "after", "unsteady")
        )
        steps = known.get("steps")
        self._steps: Array | None = None if steps is None else np.array(steps)

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it."""
        return {
            "n": self._n,
            "difference": self._difference.tolist(),
            "after": self._after.tolist(),
            "unsteady": self._unsteady.tolist(),
            "steps": None if self._steps is None else self._steps.tolist(),
        }

    def interrupt(self) -> None:
        """Say that the next step does not follow the last one."""
        self._steps = None

    def learn(self, steps: Array) -> None:
        """Learn from a step (2, 6) by odometry and by alignment."""
        before, self._steps = self._steps, steps
        if before is None:
            return
        self._n += 1
        weight = max(FORGETTING, 1.0 / self._n)
        first, second = before[1] - before[0], steps[1] - steps[0]
        difference = 0.5 * (square(first) + square(second))
        after = products(first, second)
        unsteady = square(steps[1] - before[1]) - square(steps[0] - before[0])
        self._difference = self._difference + weight * (difference - self._difference)
        self._after = self._after + weight * (after - self._after)
        self._unsteady = self._unsteady + weight * (unsteady - self._unsteady)

    @property
    def is_known(self) -> bool:
        """Whether enough steps were seen."""
        return self._n > N_STEPS

    def gain(self, off: Array) -> Array:
        """Return how far to go from odometry to an alignment that is ``off`` (6,), (2,).

        Where it is off by far more than usual, either of them is wrong altogether.
        """
        gain = self._gain()
        if (square(off) > SLIP**2 * self._difference).any():
            return np.full(2, np.round(gain.mean()))
        return gain

    def _gain(self) -> Array:
        difference = np.maximum(self._difference, TINY)
        gain = np.clip(0.5 - self._unsteady / (4.0 * difference), 0.0, 1.0)
        return np.where(self._after > PERSISTENT * difference, 1.0, gain)
