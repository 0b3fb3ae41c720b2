"""A depth image made small, with the normals of its surfaces: what alignment looks at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["View", "make_view"]

WIDTH_PX = 160
"""About so wide is the image that points are taken of; alignment sees every second of them."""
MIN_RANGE_M = 0.1
MAX_RANGE_M = 8.0
"""Depths outside are dropped."""
MAX_SLOPE = 0.1
"""A step in depth of more than this share, plus as much of a metre, is an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Every few pixels of a depth image.

    ``depth_m`` (h, w) and ``normals_camera`` (h, w, 3), towards the camera, are float32, zero
    where unknown; ``intrinsics`` are of this small image.
    """

    depth_m: NDArray[np.float32]
    normals_camera: NDArray[np.float32]
    intrinsics: Intrinsics

    def rays(self) -> NDArray[np.float32]:
        """Return what a pixel's depth is multiplied by to make its point, (h, w, 3)."""
        return _rays(self.intrinsics)


def make_view(frame: DepthFrame) -> tuple[View, NDArray[np.float32]]:
    """Return the small view of a frame, and the points (N, 3) of twice as fine a grid."""
    stride = max(1, round(frame.intrinsics.width / WIDTH_PX))
    depth_m = frame.depth_m(stride)
    depth_m[(depth_m < MIN_RANGE_M) | (depth_m > MAX_RANGE_M)] = 0.0
    points = _rays(_shrunk(frame.intrinsics, stride)) * depth_m[..., None]
    normals = surface_normals(np.ascontiguousarray(points[::2, ::2]))
    view = View(depth_m[::2, ::2], normals, _shrunk(frame.intrinsics, 2 * stride))
    return view, points[depth_m > 0]


def surface_normals(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the normals (h, w, 3) of a grid of points, zero at edges and where points miss.

    Each is square to the lines between the pixel's neighbours, left to right and top to bottom.
    """
    normals = np.zeros_like(points)
    depth = points[..., 2]
    known = depth > 0
    across = points[1:-1, 2:] - points[1:-1, :-2]
    along = points[2:, 1:-1] - points[:-2, 1:-1]
    square = np.cross(along, across)
    length = np.linalg.norm(square, axis=-1)
    step = MAX_SLOPE * (1.0 + depth[1:-1, 1:-1])
    smooth = (
        known[1:-1, 1:-1]
        & (known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1])
        & (np.abs(across[..., 2]) < step)
        & (np.abs(along[..., 2]) < step)
        & (length > 0)
    )
    normals[1:-1, 1:-1][smooth] = square[smooth] / length[smooth, None]
    return normals


def _shrunk(camera: Intrinsics, stride: int) -> Intrinsics:
    """Return the camera of every ``stride``-th pixel."""
    return Intrinsics(
        -(-camera.width // stride),
        -(-camera.height // stride),
        camera.fx / stride,
        camera.fy / stride,
        camera.cx / stride,
        camera.cy / stride,
    )


def _rays(camera: Intrinsics) -> NDArray[np.float32]:
    """Return what a pixel's depth is multiplied by to make its point, (h, w, 3)."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return np.dstack([*np.meshgrid(x, y), np.ones((len(y), len(x)))]).astype(np.float32)
