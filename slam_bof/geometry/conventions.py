"""Axes of moving frames as different programs have them."""

from __future__ import annotations

import numpy as np

from slam_bof.types import Array

__all__ = ["AXES"]

AXES: dict[str, Array] = {
    "camera": np.eye(3),
    "ros": np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]),
    "opengl": np.diag([1.0, -1.0, -1.0]),
}
"""``R_recorded_camera`` (3, 3) of each convention: ``camera`` x right, y down, z forward; ``ros``
(base_link, REP-103) x forward, y left, z up; ``opengl`` x right, y up, z back."""
