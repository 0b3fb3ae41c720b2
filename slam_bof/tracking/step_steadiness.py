"""Which moves more steadily from frame to frame, odometry or alignment.

Both follow the motion of the camera, so what the steps of one change by beyond those of the other
is its noise.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.types import Array

__all__ = ["StepSteadiness"]

FORGETTING = 0.01
"""Weight of the newest frame."""
N_REFERENCE = 6
"""Pairs of steps after which it is known what is usual."""
OUTLIER = 5.0
"""Differences greater than usual by more than this factor count as this much."""
MIN_EXCESS = 1.0
"""Odometry is the steadier of the two if the mean squares of changes from step to step differ by
this multiple of that of differences between odometry and alignment. If odometry errs, it is
negative, or near zero if odometry follows the motion too little."""
MAX_VARIANCE = 1000.0
"""Differences of more than this, in terms of what the points of an alignment tell, are
odometry's."""


class StepSteadiness:
    """Takes the steps of odometry and alignment from frame to frame, where both are known.

    Squares are means over the directions that the surfaces hold, in terms of the variance that the
    points of an alignment tell along each.
    """

    def __init__(self) -> None:
        self._steps: Array | None = None  # (2, 6) to the last frame, by odometry and by alignment
        self._n = 0
        self._difference = 0.0  # between odometry and alignment
        self._excess = 0.0  # of changes from step to step, of alignment less odometry's

    def interrupt(self) -> None:
        """Take a frame that was not aligned: the step to the next one is not known."""
        self._steps = None

    def learn(self, steps: Array, whiten: Array, innovation: Array) -> None:
        """Learn from the steps to the next frame.

        Parameters
        ----------
        steps
            (2, 6) tangents of the step by odometry and by alignment.
        whiten
            (n, 6) that whitens tangents by the noise of the alignment.
        innovation
            (n,) whitened difference between odometry and alignment.
        """
        before, self._steps = self._steps, steps
        if before is None:
            return
        self._n += 1
        weight = max(FORGETTING, 1.0 / self._n)
        changes = np.square((steps - before) @ whiten.T).mean(axis=1)
        difference, excess = float(np.mean(innovation**2)), float(changes[1] - changes[0])
        if self._n > N_REFERENCE:
            most = OUTLIER**2 * self._difference
            difference = min(difference, most)
            excess = float(np.clip(excess, -2.0 * most, 2.0 * most))
        self._difference += weight * (difference - self._difference)
        self._excess += weight * (excess - self._excess)

    @property
    def alignment_is_steadier(self) -> bool:
        """Whether alignment has moved more steadily than odometry."""
        return self._excess < 0.0

    @property
    def alignment_variance(self) -> float:
        """The variance of an alignment in terms of what its points tell, at least 1."""
        odometry_is_steadier = (
            self._n > N_REFERENCE
            and self._difference < MAX_VARIANCE
            and self._excess > MIN_EXCESS * self._difference
        )
        return max(self._difference, 1.0) if odometry_is_steadier else 1.0

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it."""
        return {
            "steps": None if self._steps is None else self._steps.tolist(),
            "n_steps": self._n,
            "difference": self._difference,
            "unsteadiness": self._excess,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from there."""
        steps = state["steps"]
        self._steps = None if steps is None else np.array(steps)
        self._n = state["n_steps"]
        self._difference, self._excess = state["difference"], state["unsteadiness"]
