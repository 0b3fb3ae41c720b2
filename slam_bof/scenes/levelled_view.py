"""A depth image in the levelled frame, with the camera's height above the floor.

Heights above the floor are what tells a table from a counter and a bed; a single view gives them
where its surfaces tell which way is down and where the floor is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import GravityTracker, level_frame, make_view, view_points
from slam_bof.types import Array, DepthFrame

__all__ = ["LevelView", "level_view"]

UPRIGHT = (0.0, 1.0, 0.0)
"""Down, where nothing is known: a camera is held about upright."""
USUAL_HEIGHT_M = 1.4
"""Of a camera in the hands, where no floor is seen; no less than the lowest thing in view."""
HEIGHTS_M = (0.3, 2.3)
"""Where the floor may be below the camera."""
MIN_HEIGHT_M = 0.95
"""What lies level nearer to the camera is no floor."""
STEP_M = 0.05
MIN_FLOOR_SHARE = 0.003
"""Of the view's pixels, that must lie level within two steps of height to be a floor."""
LOWEST_PERCENTILE = 99.5
BELOW_FLOOR_M = 0.15
"""Of what lies more than this below, nothing is a floor."""
FLOOR_COSINE = 0.9


@dataclass(frozen=True, slots=True, eq=False)
class LevelView:
    """What a frame shows, in the levelled frame: y is down, z ahead.

    ``points`` (N, 3) are those of about 160 x 120 pixels. ``grid_points`` and ``grid_normals``
    (h, w, 3), of every second of these pixels, are zero where unknown. ``pixel_rad`` is the
    angle that a pixel of the grid spans. The floor is ``camera_height_m`` below, guessed unless
    ``floor_seen``.
    """

    points: NDArray[np.float32]
    grid_points: NDArray[np.float32]
    grid_normals: NDArray[np.float32]
    pixel_rad: float
    camera_height_m: float
    floor_seen: bool


def level_view(frame: DepthFrame, *, gravity_camera: Array | None = None) -> LevelView:
    """Level a frame by its surfaces.

    ``gravity_camera`` (3,) is roughly the direction down in the camera frame; without it the
    camera is taken to be held within some 40 degrees of upright.
    """
    view = make_view(frame)
    normals = view.normals_camera[view.normals_camera.any(axis=-1)]
    tracker = GravityTracker(UPRIGHT if gravity_camera is None else gravity_camera)
    R = level_frame(tracker.update(normals, np.eye(4))).astype(np.float32)
    points = view_points(frame) @ R.T
    grid_points = _turn(R, view.rays() * view.depth_m[..., None])
    grid_normals = _turn(R, view.normals_camera)
    height_m, seen = _find_floor(points[:, 1], grid_points[..., 1], grid_normals[..., 1])
    return LevelView(points, grid_points, grid_normals, 1.0 / view.intrinsics.fx, height_m, seen)


def _turn(R: NDArray[np.float32], grid: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(grid.reshape(-1, 3) @ R.T, np.float32).reshape(grid.shape)


def _find_floor(
    y: NDArray[np.float32], grid_y: NDArray[np.float32], grid_ny: NDArray[np.float32]
) -> tuple[float, bool]:
    """Return how far below the camera the floor is, and whether it is seen.

    It is the lowest height at which enough surface lies level, if nothing is far below.
    """
    if len(y) == 0:
        return USUAL_HEIGHT_M, False
    k = min(len(y) - 1, int(len(y) * LOWEST_PERCENTILE / 100))
    lowest_m = float(np.partition(y, k)[k])
    level_y = grid_y[grid_ny < -FLOOR_COSINE]
    counts, edges = np.histogram(level_y, np.arange(HEIGHTS_M[0], HEIGHTS_M[1], STEP_M))
    enough = np.flatnonzero(counts[:-1] + counts[1:] >= MIN_FLOOR_SHARE * grid_y.size)
    if len(enough):
        low, high = edges[enough[-1]], edges[enough[-1] + 2]
        floor_m = float(np.median(level_y[(level_y >= low) & (level_y < high)]))
        if floor_m > max(MIN_HEIGHT_M, lowest_m - BELOW_FLOOR_M):
            return floor_m, True
    return max(USUAL_HEIGHT_M, lowest_m), False
