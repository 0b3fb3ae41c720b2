"""Where a point falls in a view, and what the view sees there."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.types import Array

__all__ = [
    "NORMAL_STEPS",
    "ViewArrays",
    "by_axis",
    "interpolated_depth",
    "nearest_pixel",
    "project",
    "sampled_by_axis",
]

NORMAL_STEPS = 127
"""Number of steps per unit in which normals are stored as bytes."""
NEAR_M = 0.05
"""Points nearer than this, in m, count as outside of the image."""
MAX_STEP = 0.03
"""Pixels whose depths differ by less than this share of (1 m + depth) are on one surface."""
MAX_BEND = 0.03
"""Three pixels in a row are on one surface as well if their inverse depths deviate from a line by
less than this share."""


class ViewArrays(NamedTuple):
    """Views of one camera as compiled functions take them; pixels are counted row by row."""

    depths_m: NDArray[np.float32]
    """(n, height * width), 0 where unknown."""
    normals: NDArray[np.int8]
    """(n, height * width, 3), in steps, 0 where unknown."""
    sampled: NDArray[np.int32]
    """(n, n_points), a random choice of the pixels whose depth is known."""
    rays: NDArray[np.float32]
    """(height * width, 3), with z = 1."""
    roughness: NDArray[np.float64]
    """(n,) of the depth images, in 1/m."""
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@compiled
def by_axis(points: NDArray[np.floating[Any]]) -> Array:
    """Return points (m, 3) as ``project`` takes them, (3, m) float64."""
    axes = np.empty((3, len(points)))
    for i in range(len(points)):
        axes[0, i], axes[1, i], axes[2, i] = points[i, 0], points[i, 1], points[i, 2]
    return axes


@compiled
def sampled_by_axis(views: ViewArrays, row: int, n_points: int) -> Array:
    """Return the first sampled points of a view as ``project`` takes them, (3, n_points)."""
    axes = np.empty((3, n_points))
    for i in range(n_points):
        pixel = views.sampled[row, i]
        depth_m = views.depths_m[row, pixel]
        for axis in range(3):
            axes[axis, i] = views.rays[pixel, axis] * depth_m
    return axes


@compiled
def project(views: ViewArrays, T: Array, points: Array, found: Array) -> None:
    """Find where points (3, m) fall by ``T_view_point`` (4, 4).

    ``found`` (3, m) is filled: column and row, and the depth of the point, 0 if it falls outside
    the image. One loop without branches over all points becomes vector instructions.
    """
    xs, ys, zs = points[0], points[1], points[2]
    columns, rows, depths_m = found[0], found[1], found[2]
    last_column, last_row = views.width - 1.0, views.height - 1.0
    fx, fy, cx, cy = views.fx, views.fy, views.cx, views.cy
    a, b, c, d = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
    e, f, g, h = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
    p, q, r, s = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
    for i in range(len(xs)):
        x, y, z = xs[i], ys[i], zs[i]
        depth_m = p * x + q * y + r * z + s
        inverse = 1.0 / depth_m
        u = fx * inverse * (a * x + b * y + c * z + d) + cx
        v = fy * inverse * (e * x + f * y + g * z + h) + cy
        column, row = np.rint(u), np.rint(v)
        is_inside = (column >= 0) & (column <= last_column) & (row >= 0) & (row <= last_row)
        columns[i], rows[i] = u, v
        depths_m[i] = depth_m if is_inside & (depth_m > NEAR_M) else 0.0


@compiled
def nearest_pixel(width: int, column: float, row: float) -> int:
    """Return the number of the pixel that a point inside of the image falls on."""
    return int(np.rint(row)) * width + int(np.rint(column))


@compiled
def interpolated_depth(
    depths_m: NDArray[np.float32], width: int, height: int, column: float, row: float
) -> float:
    """Return the depth of a view between pixels, 0 if it is unknown or on no surface.

    The inverse depth of a plane is linear in the image. Without interpolation, the depth of a wall
    at a grazing angle may be off by decimetres, and views would seem to agree best where their
    pixels coincide. At an edge the surface of the pixel is continued.
    """
    pixel = nearest_pixel(width, column, row)
    depth_m = depths_m[pixel]
    if not depth_m > 0.0:
        return 0.0
    inverse = 1.0 / depth_m
    limit = MAX_STEP * (inverse + inverse * inverse)
    change = 0.0
    for at, step, size in ((column, 1, width), (row, width, height)):
        position = int(np.rint(at))
        offset = at - position
        towards = 1 if offset > 0 else -1
        ahead = _inverse_depth(depths_m, pixel + towards * step, position + towards, size) - inverse
        behind = inverse - _inverse_depth(
            depths_m, pixel - towards * step, position - towards, size
        )
        if abs(ahead) < limit or abs(ahead - behind) < MAX_BEND * inverse:
            change += abs(offset) * ahead
        elif abs(behind) < limit:
            change += abs(offset) * behind
        else:
            return 0.0
    return float(1.0 / (inverse + change))


@compiled
def _inverse_depth(depths_m: NDArray[np.float32], pixel: int, position: int, size: int) -> float:
    """Return 1 / depth of a pixel, 0 if it is unknown or its position is outside the image."""
    if position < 0 or position >= size or not depths_m[pixel] > 0.0:
        return 0.0
    return 1.0 / float(depths_m[pixel])
