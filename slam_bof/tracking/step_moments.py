"""How far the steps of odometry and of alignment differ, and how unsteady each is."""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.types import Array

__all__ = ["SLIP", "StepMoments"]

FORGETTING = 0.05
"""Weight of the newest steps in what is known of the noise: about a second of a camera."""
SLIP = 3.0
"""Differences greater than usual by this factor are slips of odometry or of alignment."""
OUTLIER = 5.0
"""Greater ones than this count as this much in what is usual."""
N_REFERENCE = 6
"""Pairs of steps after which it is known what is usual."""


class StepMoments:
    """Takes pairs of steps that follow each other, each by odometry and by alignment.

    Tangents are whitened: they count by the information with which the surfaces hold a direction,
    so that noise along those that are weakly held does not hide how precise odometry is along the
    others. All values are means over the directions that are held.

    Attributes
    ----------
    n
        Number of pairs of steps.
    difference
        Mean square of the difference between odometry and alignment in a step.
    after
        Mean product of such a difference and the next.
    unsteady
        Mean square of the change from one step to the next, of alignment less that of odometry.
    information
        Mean information of a direction, in 1/m^2 and 1/rad^2.
    """

    def __init__(self, state: dict[str, Any] | None = None) -> None:
        known = state or {}
        self.n: int = known.get("n", 0)
        self.difference: float = known.get("difference", 0.0)
        self.after: float = known.get("after", 0.0)
        self.unsteady: float = known.get("unsteady", 0.0)
        self.information: float = known.get("information", 1.0)

    def state(self) -> dict[str, Any]:
        """Return what was learnt so far, as JSON has it."""
        return dict(vars(self))

    def learn(self, before: Array, now: Array, information: Array, n_held: int) -> None:
        """Learn from two steps, (2, 6) each, and the information (6, 6) of the last alignment."""
        self.n += 1
        weight = max(FORGETTING, 1.0 / self.n)
        first, second = before[1] - before[0], now[1] - now[0]
        changes = now - before

        def mean(a: Array, b: Array) -> float:
            return float(a @ information @ b) / n_held

        most = OUTLIER**2 * self.difference if self.n > N_REFERENCE else np.inf
        for name, value, limit in (
            ("difference", 0.5 * (mean(first, first) + mean(second, second)), most),
            ("after", mean(first, second), most),
            ("unsteady", mean(changes[1], changes[1]) - mean(changes[0], changes[0]), 6.0 * most),
            ("information", float(np.trace(information)) / n_held, np.inf),
        ):
            known: float = getattr(self, name)
            setattr(self, name, known + weight * (float(np.clip(value, -limit, limit)) - known))
