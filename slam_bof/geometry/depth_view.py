"""A depth image made small, with the normals of its surfaces: what alignment looks at."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry.camera import PointParams, points_camera_f32
from slam_bof.types import DepthFrame, Intrinsics, SubsampledDepth

__all__ = [
    "DepthView",
    "make_view",
    "quantize_depth",
    "restore_frame",
    "subsample",
    "view_points",
    "view_stride",
]

WIDTH_PX = 160
"""About so wide is the image that points are taken of; a view has every second of its pixels."""
MIN_RANGE_M = 0.1
MAX_RANGE_M = 8.0
"""Depths outside are dropped."""
STEPS_PER_M = 8000
"""Depths in metres are kept in such steps, an eighth of a millimetre."""
MAX_SLOPE = 0.1
"""A step in depth of more than this share, plus as much of a metre, is an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
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

    def known_normals(self) -> NDArray[np.float32]:
        """Return the normals (N, 3) where there are any."""
        return np.asarray(self.normals_camera[self.normals_camera.any(axis=-1)])


def make_view(frame: DepthFrame) -> DepthView:
    """Return the small view of a frame, read-only; it is computed once and kept with the frame."""
    return frame.derive(_make_view)


def _make_view(frame: DepthFrame) -> DepthView:
    stride = 2 * view_stride(frame.intrinsics)
    depth_m = frame.depth_m(stride)
    depth_m[(depth_m < MIN_RANGE_M) | (depth_m > MAX_RANGE_M)] = 0.0
    camera = _shrunk(frame.intrinsics, stride)
    normals = surface_normals(_rays(camera) * depth_m[..., None])
    for shared in (depth_m, normals):
        shared.setflags(write=False)
    return DepthView(depth_m, normals, camera)


def view_points(frame: DepthFrame) -> NDArray[np.float32]:
    """Return the points (N, 3) of a grid twice as fine as the view; computed once for a frame."""
    return frame.derive(_view_points)


def _view_points(frame: DepthFrame) -> NDArray[np.float32]:
    fine = PointParams(
        stride=view_stride(frame.intrinsics), min_range_m=MIN_RANGE_M, max_range_m=MAX_RANGE_M
    )
    points = points_camera_f32(frame, fine)
    points.setflags(write=False)
    return points


def quantize_depth(frame: DepthFrame) -> DepthFrame:
    """Return the frame with depths as the map can keep them: those in metres are rounded.

    So a map that is loaded again sees to the bit what was seen when it was made.
    """
    if frame.depth.dtype == np.uint16:
        return frame
    depth = np.rint(frame.depth.astype(np.float32) * np.float32(STEPS_PER_M))
    depth /= np.float32(STEPS_PER_M)
    return replace(frame, depth=depth)


def subsample(frame: DepthFrame) -> SubsampledDepth:
    """Return those pixels of a frame, as ``quantize_depth`` makes it, that views are made of."""
    stride = view_stride(frame.intrinsics)
    metres = frame.depth_m(stride)
    per_m = 1000 if frame.depth.dtype == np.uint16 else STEPS_PER_M
    steps = np.rint(metres * np.float32(per_m))
    steps[(metres < MIN_RANGE_M) | (metres > MAX_RANGE_M)] = 0
    return SubsampledDepth(steps.astype(np.uint16), per_m, frame.intrinsics)


def restore_frame(subsample: SubsampledDepth, stamp_s: float = 0.0) -> DepthFrame:
    """Return a frame that has the pixels kept and no others: its views are the same."""
    camera = subsample.intrinsics
    stride = view_stride(camera)
    if subsample.per_m == 1000:
        depth = np.zeros((camera.height, camera.width), np.uint16)
        depth[::stride, ::stride] = subsample.depth
    else:
        depth = np.zeros((camera.height, camera.width), np.float32)
        depth[::stride, ::stride] = subsample.depth / np.float32(subsample.per_m)
    return DepthFrame(stamp_s, depth, camera)


def surface_normals(points: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the normals (h, w, 3) of a grid of points, zero at edges and where points miss.

    Each is square to the lines between the pixel's neighbours, left to right and top to bottom.
    """
    x, y, z = np.ascontiguousarray(np.moveaxis(points, -1, 0))
    across = [c[1:-1, 2:] - c[1:-1, :-2] for c in (x, y, z)]
    along = [c[2:, 1:-1] - c[:-2, 1:-1] for c in (x, y, z)]
    square = np.stack(
        [
            along[1] * across[2] - along[2] * across[1],
            along[2] * across[0] - along[0] * across[2],
            along[0] * across[1] - along[1] * across[0],
        ],
        axis=-1,
    )
    length = np.sqrt((square * square).sum(axis=-1))
    known = z > 0
    step = MAX_SLOPE * (1.0 + z[1:-1, 1:-1])
    smooth = (
        known[1:-1, 1:-1]
        & (known[1:-1, 2:] & known[1:-1, :-2] & known[2:, 1:-1] & known[:-2, 1:-1])
        & (np.abs(across[2]) < step)
        & (np.abs(along[2]) < step)
        & (length > 0)
    )
    normals = np.zeros_like(points)
    np.divide(square, length[..., None], out=normals[1:-1, 1:-1], where=smooth[..., None])
    return normals


def view_stride(camera: Intrinsics) -> int:
    """Return the stride that makes an image about ``WIDTH_PX`` wide."""
    return max(1, round(camera.width / WIDTH_PX))


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


@lru_cache(maxsize=4)
def _rays(camera: Intrinsics) -> NDArray[np.float32]:
    """Return what a pixel's depth is multiplied by to make its point, (h, w, 3)."""
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    rays = np.dstack([*np.meshgrid(x, y), np.ones((len(y), len(x)))]).astype(np.float32)
    rays.setflags(write=False)
    return rays
