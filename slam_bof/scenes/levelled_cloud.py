"""The point cloud of a depth image in the levelled frame, with the camera's height above the floor.

Heights above the floor distinguish a table from a counter and a bed. A single frame shows them if
its surfaces reveal the direction of gravity and the floor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import GravityTracker, level_frame, make_view, view_points
from slam_bof.types import Array, DepthFrame

__all__ = ["LevelledCloud", "levelled_cloud"]

DEFAULT_GRAVITY_CAMERA = (0.0, 1.0, 0.0)
"""Initial direction of gravity where none is given: the camera is held about upright."""
DEFAULT_HEIGHT_M = 1.4
"""Height of a hand-held camera, assumed where no floor is seen and nothing is lower."""
HEIGHTS_M = (0.3, 2.3)
"""Range of camera heights in which the floor is searched."""
MIN_HEIGHT_M = 0.95
"""Level surfaces less far below the camera are no floor."""
STEP_M = 0.05
"""Bin width of the histogram of heights."""
MIN_FLOOR_SHARE = 0.003
"""Least share of the grid's pixels that must be level within two bins to be a floor."""
LOWEST_PERCENTILE = 99.5
"""Percentile of the points' y that counts as the lowest point; the rest are outliers."""
BELOW_FLOOR_M = 0.15
"""A surface is no floor if the lowest point is more than this below it."""
MIN_POSSIBLE_FLOOR_SHARE, MAX_SHARE_BELOW = 0.15, 0.1
"""Where no floor is seen, a nearer level surface may be one if it has at least this share of the
grid's pixels, and at most this share of the points lies below it."""
FLOOR_COSINE = 0.9
"""Least cosine between the normal of a level surface and the vertical."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelledCloud:
    """The points of a frame in the levelled frame: y is down, z ahead, in metres.

    ``points`` (N, 3) are those of about 160 x 120 pixels. ``grid_points`` and ``grid_normals``
    (h, w, 3), of every second of these pixels, are zero where unknown. ``pixel_rad`` is the
    angle that a pixel of the grid spans. The floor is ``camera_height_m`` below the camera, an
    assumption unless ``floor_seen``. ``possible_height_m`` is another possible height, where a
    large level surface is a floor near the camera of a small robot, or a table.
    """

    points: NDArray[np.float32]
    grid_points: NDArray[np.float32]
    grid_normals: NDArray[np.float32]
    pixel_rad: float
    camera_height_m: float
    floor_seen: bool
    possible_height_m: float | None = None


def levelled_cloud(frame: DepthFrame, *, gravity_camera: Array | None = None) -> LevelledCloud:
    """Level a frame by the normals of its surfaces.

    Parameters
    ----------
    frame
        The depth image.
    gravity_camera
        (3,) approximate direction of gravity in the camera frame; without it the camera is
        assumed to be within some 40 degrees of upright.
    """
    view = make_view(frame)
    normals = view.normals_camera[view.normals_camera.any(axis=-1)]
    initial = DEFAULT_GRAVITY_CAMERA if gravity_camera is None else gravity_camera
    tracker = GravityTracker(initial)
    R = level_frame(tracker.update(normals, np.eye(4))).astype(np.float32)
    points = view_points(frame) @ R.T
    grid_points = _rotate_grid(R, view.rays() * view.depth_m[..., None])
    grid_normals = _rotate_grid(R, view.normals_camera)
    height_m, floor_seen = _find_floor(points[:, 1], grid_points[..., 1], grid_normals[..., 1])
    return LevelledCloud(
        points=points,
        grid_points=grid_points,
        grid_normals=grid_normals,
        pixel_rad=1.0 / view.intrinsics.fx,
        camera_height_m=height_m,
        floor_seen=floor_seen,
        possible_height_m=(
            None if floor_seen else _find_possible_floor(points[:, 1], grid_points, grid_normals)
        ),
    )


def _rotate_grid(R: NDArray[np.float32], grid: NDArray[np.float32]) -> NDArray[np.float32]:
    return np.asarray(grid.reshape(-1, 3) @ R.T, np.float32).reshape(grid.shape)


def _find_floor(
    y: NDArray[np.float32], grid_y: NDArray[np.float32], grid_ny: NDArray[np.float32]
) -> tuple[float, bool]:
    """Return the camera's height above the floor in metres, and whether the floor is seen.

    The floor is the lowest height with enough level surface, if no point is far below it.
    """
    if len(y) == 0:
        return DEFAULT_HEIGHT_M, False
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
    return max(DEFAULT_HEIGHT_M, lowest_m), False


def _find_possible_floor(
    y: NDArray[np.float32], grid_points: NDArray[np.float32], grid_normals: NDArray[np.float32]
) -> float | None:
    """Return how far below the camera a level surface is that may be the floor, if one is."""
    is_level = grid_normals[..., 1] < -FLOOR_COSINE
    counts, edges = np.histogram(
        grid_points[..., 1][is_level], np.arange(HEIGHTS_M[0], MIN_HEIGHT_M + STEP_M, STEP_M)
    )
    largest = int((counts[:-1] + counts[1:]).argmax())
    share = (counts[largest] + counts[largest + 1]) / is_level.size
    low, high = edges[largest], edges[largest + 2]
    if share < MIN_POSSIBLE_FLOOR_SHARE or (y > high + BELOW_FLOOR_M).mean() > MAX_SHARE_BELOW:
        return None
    level_y = grid_points[..., 1][is_level]
    return float(np.median(level_y[(level_y >= low) & (level_y < high)]))
