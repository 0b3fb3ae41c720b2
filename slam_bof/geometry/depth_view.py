"""The small depth image with surface normals that registration uses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.geometry.camera import PointParams, points_camera_f32, ray_slopes
from slam_bof.types import DepthFrame, Intrinsics, SensorParams, SubsampledDepth

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
"""Approximate width of the image that points are taken from. A view has half this width."""
STEPS_PER_M = 8000
"""Finest resolution at which the map keeps depths in metres: steps of 1/8 mm."""
BEYOND_M = 1e6
"""Farther than any sensor sees."""
DIRECTIONS = (0, 1), (1, 0), (1, 1), (1, -1)
"""Rows and columns from a pixel to four of its neighbours; the other four are opposite."""
MAX_BEND = 3.0
"""Neighbours that are out of line by more than this times the median are not on one surface."""
MIN_FILLING = 2
"""A pixel without depth is filled in if at least as many pairs of its neighbours agree."""
MAX_STEPS = 65535
"""Largest number of steps that the map can keep."""


@dataclass(frozen=True, slots=True, eq=False)
class DepthView:
    """A subsampled depth image with surface normals.

    ``depth_m`` (h, w) and ``normals_camera`` (h, w, 3), which point towards the camera, are
    float32 and zero where unknown. ``intrinsics`` are those of the subsampled image. ``roughness``
    is the median of the second differences of inverse depth along rows of the image that was
    subsampled, in 1/m; 0 if none is known.
    """

    depth_m: NDArray[np.float32]
    normals_camera: NDArray[np.float32]
    intrinsics: Intrinsics
    roughness: float = 0.0

    def rays(self) -> NDArray[np.float32]:
        """Return the rays (h, w, 3) with z = 1: a point is its depth times its ray."""
        return _rays(self.intrinsics)

    def known_normals(self) -> NDArray[np.float32]:
        """Return all known normals (N, 3)."""
        return np.asarray(self.normals_camera[self.normals_camera.any(axis=-1)])


def make_view(frame: DepthFrame) -> DepthView:
    """Return the read-only view of a frame. It is computed once and cached in the frame."""
    return frame.derive(_make_view)


def _make_view(frame: DepthFrame) -> DepthView:
    """Return the view of every second pixel of the grid of ``view_points``."""
    depth_m, roughness = smooth_depth(
        frame.depth_in_range_m(view_stride(frame.intrinsics)), frame.sensor.edge_ratio
    )
    camera = _shrunk(frame.intrinsics, 2 * view_stride(frame.intrinsics))
    normals = surface_normals(_rays(camera) * depth_m[..., None], frame.sensor.edge_ratio)
    for shared in (depth_m, normals):
        shared.setflags(write=False)
    return DepthView(depth_m, normals, camera, roughness)


def view_points(frame: DepthFrame) -> NDArray[np.float32]:
    """Return the points (N, 3) of a grid twice as fine as the view, cached in the frame."""
    return frame.derive(_view_points)


def _view_points(frame: DepthFrame) -> NDArray[np.float32]:
    stride = view_stride(frame.intrinsics)
    points = points_camera_f32(
        frame, PointParams(stride=stride, min_range_m=0.0, max_range_m=BEYOND_M)
    )
    points.setflags(write=False)
    return points


def quantize_depth(frame: DepthFrame) -> DepthFrame:
    """Return the frame with depths in metres rounded to the steps in which the map keeps them.

    A map that is loaded again therefore has exactly the depths that were processed.
    """
    if frame.depth.dtype == np.uint16:
        return frame
    per_m = np.float32(_steps_per_m(frame.sensor))
    return replace(frame, depth=np.rint(frame.depth.astype(np.float32) * per_m) / per_m)


def subsample(frame: DepthFrame) -> SubsampledDepth:
    """Return the pixels of a quantised frame (see ``quantize_depth``) that views use."""
    stride = view_stride(frame.intrinsics)
    per_m = 1000 if frame.depth.dtype == np.uint16 else _steps_per_m(frame.sensor)
    steps = np.rint(frame.depth_in_range_m(stride) * np.float32(per_m))
    return SubsampledDepth(steps.astype(np.uint16), per_m, frame.intrinsics)


def restore_frame(subsample: SubsampledDepth, stamp_s: float = 0.0) -> DepthFrame:
    """Return a frame with the saved pixels alone. Its views equal those of the original frame."""
    camera = subsample.intrinsics
    stride = view_stride(camera)
    if subsample.per_m == 1000:
        depth = np.zeros((camera.height, camera.width), np.uint16)
        depth[::stride, ::stride] = subsample.depth
    else:
        depth = np.zeros((camera.height, camera.width), np.float32)
        depth[::stride, ::stride] = subsample.depth / np.float32(subsample.per_m)
    # The range of the sensor was applied when the depths were saved.
    whole = SensorParams(min_depth_m=0.0, max_depth_m=min(60.0, MAX_STEPS / subsample.per_m))
    return DepthFrame(stamp_s, depth, camera, whole)


def _steps_per_m(sensor: SensorParams) -> int:
    """Return the resolution at which a map keeps depths in metres up to those of the sensor."""
    return min(STEPS_PER_M, int(MAX_STEPS / sensor.max_depth_m + 1e-6))


@compiled
def smooth_depth(
    depth_m: NDArray[np.float32], edge_ratio: float = 0.1
) -> tuple[NDArray[np.float32], float]:
    """Return every second pixel of a depth image, each smoothed by its eight neighbours.

    The second value is the roughness that ``DepthView`` has.

    The inverse depth of a plane is linear in the image: the mean of two opposite neighbours is that
    of the pixel between them. So the mean over the pairs that are in line with it has less noise,
    and the plane does not move. How far they are off by noise is taken from the image, most of
    whose pixels are on smooth surfaces; those that are off by more are at an edge.

    A pixel without depth (0) gets the mean over the pairs of opposite neighbours between which
    there is no edge by ``edge_ratio``, which is that of ``SensorParams``; it remains 0 if there are
    less than two.
    """
    height, width = depth_m.shape
    smooth = depth_m[::2, ::2].copy()
    bends = np.full((*smooth.shape, 4), np.inf)
    noise, n_known = np.zeros(smooth.size), 0
    for row in range(2, height - 1, 2):
        for column in range(2, width - 1, 2):
            here = depth_m[row, column]
            around, n_around = 0.0, 0
            for k in range(4):
                down, right = DIRECTIONS[k]
                one = depth_m[row + down, column + right]
                other = depth_m[row - down, column - right]
                if not min(one, other) > 0.0:
                    continue
                if here > 0.0:
                    bend = 1.0 / one + 1.0 / other - 2.0 / here
                    bends[row // 2, column // 2, k] = bend
                    if k == 0:
                        noise[n_known] = abs(bend)
                        n_known += 1
                elif abs(one - other) < edge_ratio * (1.0 + min(one, other)):
                    around += 0.5 / one + 0.5 / other
                    n_around += 1
            if n_around >= MIN_FILLING:
                smooth[row // 2, column // 2] = n_around / around
    roughness = float(np.median(noise[:n_known])) if n_known else 0.0
    limit = MAX_BEND * roughness
    for row in range(smooth.shape[0]):
        for column in range(smooth.shape[1]):
            total, n = 0.0, 1
            for k in range(4):
                if abs(bends[row, column, k]) <= limit:
                    total += bends[row, column, k]
                    n += 2
            if n > 1:
                smooth[row, column] = 1.0 / (1.0 / smooth[row, column] + total / n)
    return smooth, roughness


@compiled
def surface_normals(points: NDArray[np.float32], edge_ratio: float = 0.1) -> NDArray[np.float32]:
    """Return the normals (h, w, 3) of a grid of points, zero at edges and where points miss.

    Each is the cross product of the differences between the neighbours of the pixel, below minus
    above and right minus left. ``edge_ratio`` is that of ``SensorParams``.
    """
    height, width, _ = points.shape
    normals = np.zeros_like(points)
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            left, right = points[row, column - 1], points[row, column + 1]
            above, below = points[row - 1, column], points[row + 1, column]
            z = points[row, column, 2]
            if not min(z, left[2], right[2], above[2], below[2]) > 0.0:
                continue
            step = edge_ratio * (1.0 + z)
            if abs(right[2] - left[2]) >= step or abs(below[2] - above[2]) >= step:
                continue
            p, q, r = below[0] - above[0], below[1] - above[1], below[2] - above[2]
            u, v, w = right[0] - left[0], right[1] - left[1], right[2] - left[2]
            x, y, z = q * w - r * v, r * u - p * w, p * v - q * u
            length = np.sqrt(x * x + y * y + z * z)
            if length > 0.0:
                normals[row, column, 0] = x / length
                normals[row, column, 1] = y / length
                normals[row, column, 2] = z / length
    return normals


def view_stride(camera: Intrinsics) -> int:
    """Return the stride that subsamples an image to a width of about ``WIDTH_PX``."""
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
    """Return the rays (h, w, 3) of all pixels with z = 1."""
    x, y = ray_slopes(camera)
    rays = np.dstack([*np.meshgrid(x, y), np.ones((len(y), len(x)))]).astype(np.float32)
    rays.setflags(write=False)
    return rays
