"""Point clouds without a depth image, seen through a virtual camera.

Everything after the odometry looks at depth images. A cloud of a depth camera is projected into
such an image again; of one all around, as a LiDAR makes it, a view is cut that always looks in the
same direction *of the odometry's frame*, level, however the sensor is turned: then a place that
is come back to the other way round shows the same view, and what moves in it from scan to scan is
the place alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.geometry import se3
from slam_bof.geometry.gravity import level_frame
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose

__all__ = ["CloudCamera", "Seen", "render"]

MAX_TANGENT = np.tan(np.radians(60.0))
"""Wider views than 120 degrees are cut: a pinhole image of more is mostly its edges."""
AHEAD = 0.9
"""Of a depth camera's points at least so many fall into such a view; else it is all around."""
MARGIN = 1.02
QUANTILE = 0.995
"""A few points beyond do not make the view wider."""
POINTS_PER_PIXEL = 1.5
MIN_WIDTH_PX, MAX_WIDTH_PX = 160, 320
MIN_POINTS = 100
"""Fewer do not tell what the sensor sees."""
NEAR_M = 0.05
SAME_SURFACE = 0.1
"""Depths that differ by less, as a share, are of one surface: points of a pixel, ends of a gap."""
MAX_GAP_PX = 6
"""The widest hole between points of one surface that is closed: a LiDAR's rings are apart."""


class Seen(NamedTuple):
    """What the virtual camera sees of a cloud, and how it stands in the sensor's frame."""

    frame: DepthFrame
    T_camera_view: Pose


class CloudCamera:
    """Looks at the clouds of one sensor; the first cloud tells which kind that is.

    Parameters
    ----------
    gravity_odom
        (3,) roughly down in the odometry's frame.
    """

    def __init__(self, gravity_odom: ArrayLike = (0.0, 1.0, 0.0)) -> None:
        self._R_odom_view = level_frame(np.asarray(gravity_odom, dtype=np.float64)).T
        self._intrinsics: Intrinsics | None = None
        self._is_around = False

    @property
    def is_around(self) -> bool | None:
        """Whether the sensor looks all around; None before the first cloud has told."""
        return None if self._intrinsics is None else self._is_around

    def restore(self, intrinsics: Intrinsics, is_around: bool) -> None:
        """Go on with the camera that earlier clouds were seen through."""
        self._intrinsics, self._is_around = intrinsics, is_around

    def observe(self, stamp_s: float, points_camera: Array, T_odom_camera: Pose) -> Seen:
        """Return the view of a cloud.

        Parameters
        ----------
        stamp_s
            Time in seconds.
        points_camera
            (N, 3) in metres, x right, y down, z forward; rows that are not finite are dropped.
        T_odom_camera
            (4, 4) the sensor's pose.

        Raises
        ------
        ValueError
            If the points are not (N, 3).
        """
        points = np.asarray(points_camera, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3:
            raise ValueError(f"points_camera must be (N, 3), got {points.shape}")
        points = points[np.isfinite(points).all(axis=1)]
        if self._intrinsics is None and len(points) >= MIN_POINTS:
            self._settle(points, T_odom_camera)
        T_camera_view = self._T_camera_view(T_odom_camera)
        camera = self._intrinsics
        if camera is None:  # nothing was seen yet, and nothing is now
            camera, points = _camera(np.ones(2), 1), np.empty((0, 3))
        depth_m = render(se3.transform(se3.inverse(T_camera_view), points), camera)
        return Seen(DepthFrame(stamp_s, depth_m, camera), T_camera_view)

    def _T_camera_view(self, T_odom_camera: Pose) -> Pose:
        if not self._is_around:
            return np.eye(4)
        R = np.asarray(T_odom_camera)[:3, :3].T @ self._R_odom_view
        return se3.pose(R, np.zeros(3))

    def _settle(self, points: Array, T_odom_camera: Pose) -> None:
        """Choose the camera by the extent and the density of a cloud."""
        self._is_around = not _falls_ahead(points).mean() >= AHEAD
        R_view_camera = self._T_camera_view(T_odom_camera)[:3, :3].T
        ahead = points @ R_view_camera.T
        ahead = ahead[_falls_ahead(ahead)]
        if len(ahead) < MIN_POINTS:  # a narrow sensor that looks elsewhere
            return
        slopes = np.abs(ahead[:, :2]) / ahead[:, 2:]
        tangents = MARGIN * np.quantile(slopes, QUANTILE, axis=0)
        self._intrinsics = _camera(np.minimum(tangents, MAX_TANGENT), len(ahead))


def render(points_view: Array, camera: Intrinsics) -> NDArray[np.float32]:
    """Return the depth image (H, W) float32 in metres that a camera has of points, 0 where none.

    Of a pixel's points the nearest surface is taken, in the mean. Holes of up to ``MAX_GAP_PX``
    between points of one surface are closed: along a line across a plane, inverse depth is
    linear.
    """
    inverse = np.zeros(camera.height * camera.width)
    x, y, z = points_view[points_view[:, 2] > NEAR_M].T
    column = np.rint(camera.fx * x / z + camera.cx).astype(np.intp)
    row = np.rint(camera.fy * y / z + camera.cy).astype(np.intp)
    inside = (column >= 0) & (column < camera.width) & (row >= 0) & (row < camera.height)
    pixel, near = (row * camera.width + column)[inside], 1.0 / z[inside]
    np.maximum.at(inverse, pixel, near)
    front = near >= (1.0 - SAME_SURFACE) * inverse[pixel]
    count = np.bincount(pixel[front], minlength=len(inverse))
    total = np.bincount(pixel[front], weights=near[front], minlength=len(inverse))
    image: Array = (total / np.maximum(count, 1)).reshape(camera.height, camera.width)
    for axis in (1, 0):
        image = _bridge(image, axis)
    depth_m = np.zeros_like(image)
    np.divide(1.0, image, out=depth_m, where=image > 0)
    return depth_m.astype(np.float32)


def _bridge(inverse: Array, axis: int) -> Array:
    """Close the gaps along an axis between pixels of one surface, linearly."""
    lines = np.moveaxis(inverse, axis, -1)
    n = lines.shape[-1]
    at = np.where(lines > 0, np.arange(n), -1)
    before = np.maximum.accumulate(at, axis=-1)
    at = np.where(lines > 0, np.arange(n), n)
    after = np.minimum.accumulate(at[..., ::-1], axis=-1)[..., ::-1]
    first = np.take_along_axis(lines, np.maximum(before, 0), axis=-1)
    last = np.take_along_axis(lines, np.minimum(after, n - 1), axis=-1)
    gap = after - before
    closes = (lines == 0) & (before >= 0) & (after < n) & (gap <= MAX_GAP_PX + 1)
    closes &= np.abs(first - last) < SAME_SURFACE * np.maximum(first, last)
    fraction = (np.arange(n) - before) / np.maximum(gap, 1)
    bridged = np.where(closes, first + fraction * (last - first), lines)
    return np.moveaxis(bridged, -1, axis)


def _falls_ahead(points: Array) -> NDArray[np.bool_]:
    x, y, z = points.T
    reach = MAX_TANGENT * z
    return np.asarray((z > NEAR_M) & (np.abs(x) < reach) & (np.abs(y) < reach))


def _camera(tangents: Array, n_points: int) -> Intrinsics:
    """Return a camera with square pixels that sees so far to each side (2,), x and y."""
    across, along = (max(float(t), 0.05) for t in tangents)
    width = np.sqrt(n_points / POINTS_PER_PIXEL * across / along)
    width_px = 2 * round(float(np.clip(width, MIN_WIDTH_PX, MAX_WIDTH_PX)) / 2)
    focal_px = 0.5 * width_px / across
    height_px = max(2 * round(focal_px * along), 2)
    return Intrinsics(
        width_px, height_px, focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2
    )
