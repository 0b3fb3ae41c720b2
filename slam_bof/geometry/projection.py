"""Where a point falls in a view, and what the view sees there."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.types import Array

__all__ = ["NORMAL_STEPS", "OUTSIDE", "ViewArrays", "interpolated_depth", "project"]

OUTSIDE = -1
"""Pixel of points that fall outside the image."""
NORMAL_STEPS = 127
"""Number of steps per unit in which normals are stored as bytes."""
NEAR_M = 0.05
"""Points nearer than this fall outside."""
MAX_STEP = 0.03
"""Pixels whose depths differ by less than this share of (1 m + depth) are on one surface."""
MAX_BEND = 0.03
"""So are three in a row whose inverse depths deviate from a line by less than this share."""


class ViewArrays(NamedTuple):
    """Views of one camera as compiled functions take them; pixels are counted row by row."""

    depths_m: NDArray[np.float32]
    """(n, height * width), 0 where unknown."""
    normals: NDArray[np.int8]
    """(n, height * width, 3), in steps, 0 where unknown."""
    rays: NDArray[np.float32]
    """(height * width, 3), with z = 1."""
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


@compiled
def project(
    views: ViewArrays, T: Array, x: float, y: float, z: float
) -> tuple[int, float, float, float]:
    """Return the pixel on which a point falls by ``T_view_point`` (4, 4), ``OUTSIDE`` if on none.

    Also the offset from that pixel in columns and rows, -0.5 to 0.5, and the depth of the point.
    """
    depth_m = T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]
    if not depth_m > NEAR_M:
        return OUTSIDE, 0.0, 0.0, depth_m
    inverse = 1.0 / depth_m
    u = views.fx * inverse * (T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]) + views.cx
    v = views.fy * inverse * (T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]) + views.cy
    column, row = np.rint(u), np.rint(v)
    if not (0 <= column < views.width and 0 <= row < views.height):
        return OUTSIDE, 0.0, 0.0, depth_m
    return int(row) * views.width + int(column), u - column, v - row, depth_m


@compiled
def interpolated_depth(
    views: ViewArrays, view: int, pixel: int, column_offset: float, row_offset: float
) -> float:
    """Return the depth of a view beside a pixel, 0 if it is unknown or on no surface.

    The inverse depth of a plane is linear in the image. Without interpolation, the depth of a wall
    at a grazing angle may be off by decimetres, and views would seem to agree best where their
    pixels coincide. At an edge the surface of the pixel is continued.
    """
    depths_m = views.depths_m[view]
    depth_m = depths_m[pixel]
    if not depth_m > 0.0:
        return 0.0
    row, column = divmod(pixel, views.width)
    inverse = 1.0 / depth_m
    limit = MAX_STEP * (inverse + inverse * inverse)
    change = 0.0
    for offset, step, position, size in (
        (column_offset, 1, column, views.width),
        (row_offset, views.width, row, views.height),
    ):
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
