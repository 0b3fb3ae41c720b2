"""KISS-ICP's adaptive correspondence distance, with a state that can be saved.

That of the library itself cannot be read. To resume a run with the same bytes, this one computes
the same in the same order of operations, so that it agrees to the last bit.
"""

from __future__ import annotations

import math

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["AdaptiveThreshold"]


class AdaptiveThreshold:
    """Standard deviation of how far poses were from those that constant velocity predicts.

    Parameters
    ----------
    initial_threshold_m
        Standard deviation that counts as the first sample, in m.
    min_motion_m
        Smallest deviation that counts, in m.
    max_range_m
        Distance at which a deviation of the rotation is taken as one in m.
    """

    def __init__(self, initial_threshold_m: float, min_motion_m: float, max_range_m: float) -> None:
        self._sum_of_squares, self._n_samples = initial_threshold_m * initial_threshold_m, 1
        self._min_motion_m, self._max_range_m = min_motion_m, max_range_m

    def get_threshold(self) -> float:
        """Return the standard deviation, in m."""
        return math.sqrt(self._sum_of_squares / self._n_samples)

    def state(self) -> Array:
        """Return the sum of squares (m^2) and the number of samples (2,)."""
        return np.array([self._sum_of_squares, self._n_samples])

    def restore(self, state: Array) -> None:
        """Continue from a state of ``state``; ``ValueError`` if it is none."""
        sum_of_squares, n_samples = map(float, state)
        if not (0.0 <= sum_of_squares < math.inf and n_samples >= 1.0 and n_samples.is_integer()):
            raise ValueError(f"found a sum of squares and a count of {state}, expected others")
        self._sum_of_squares, self._n_samples = sum_of_squares, int(n_samples)

    def update_model_deviation(self, model_deviation: Pose) -> None:
        """Learn from the pose (4, 4) of a frame relative to its prediction."""
        x, y, z = model_deviation[:3, 3].tolist()
        angle = _rotation_angle(model_deviation[:3, :3])
        error_m = math.sqrt(x * x + y * y + z * z) + 2.0 * self._max_range_m * math.sin(angle / 2.0)
        if error_m > self._min_motion_m:
            self._sum_of_squares += error_m * error_m
            self._n_samples += 1


def _rotation_angle(R: Array) -> float:
    """Return the angle of a rotation (3, 3) as Eigen does: it becomes a quaternion twice."""
    if np.trace(R) <= 0.0:  # more than 120 degrees, where the last bit is of no importance
        return float(se3.rotation_angle(R))
    w, x, y, z = _quaternion(*R.ravel().tolist())
    x2, y2, z2 = 2.0 * x, 2.0 * y, 2.0 * z
    w, x, y, z = _quaternion(
        1.0 - (y2 * y + z2 * z), y2 * x - z2 * w, z2 * x + y2 * w,
        y2 * x + z2 * w, 1.0 - (x2 * x + z2 * z), z2 * y - x2 * w,
        z2 * x - y2 * w, z2 * y + x2 * w, 1.0 - (x2 * x + y2 * y),
    )  # fmt: skip
    return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), abs(w))


def _quaternion(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, i: float
) -> tuple[float, float, float, float]:
    """Return w, x, y, z of the rotation with rows abc, def, ghi, whose trace is positive."""
    root = math.sqrt(a + (e + i) + 1.0)
    scale = 0.5 / root
    return 0.5 * root, (h - f) * scale, (c - g) * scale, (d - b) * scale
