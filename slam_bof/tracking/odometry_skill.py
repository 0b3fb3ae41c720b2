"""Whether odometry predicts the motion better than that the camera stands still.

Odometry that slips may err by as much as the camera moves or by more, frame after frame. Along
directions that the surfaces hold, alignment corrects it. Along open ones there is only odometry to
tell where the camera is, and it would lead the track away by metres.
"""

from __future__ import annotations

from slam_bof.types import Array

__all__ = ["OdometrySkill"]

FORGETTING = 0.2
"""Weight of the newest frame. Some five frames tell, since a slip does not last for long."""
MAX_ERROR_SHARE = 0.5
"""If errors have nothing to do with the motion, odometry errs by more than the camera moves where
its squared errors are a larger share than this of its squared steps."""
MIN_ERROR = 0.1
"""Odometry that errs by less than this in a step, in m or rad, does not slip. It may err by more
than a camera moves that stands still, and is needed once that begins to move."""
OUTLIER = 4.0
"""Squared errors that exceed what is known, and that limit, by more than this factor count as this
much: it takes more than one slip."""


class OdometrySkill:
    """Takes the steps of odometry from frame to frame, and what they err.

    Mean squares are those of tangents, with 1 rad like 1 m.
    """

    def __init__(self) -> None:
        self._steps = 0.0
        self._errors = 0.0

    def learn(self, step: Array, error: Array) -> None:
        """Take a frame that is held in all directions.

        Parameters
        ----------
        step
            (6,) tangent of odometry's step to it, in rad and m.
        error
            (6,) tangent from where odometry has the frame to where it is aligned.
        """
        square = min(float(error @ error), OUTLIER * max(self._errors, MIN_ERROR**2))
        self._steps += FORGETTING * (float(step @ step) - self._steps)
        self._errors += FORGETTING * (square - self._errors)

    @property
    def is_none(self) -> bool:
        """Whether odometry has told nothing of its last steps."""
        return self._errors > max(MAX_ERROR_SHARE * self._steps, MIN_ERROR**2)

    def state(self) -> list[float]:
        """Return what was learnt so far, as JSON has it."""
        return [self._steps, self._errors]

    def restore(self, state: list[float]) -> None:
        """Go on from there."""
        self._steps, self._errors = state
