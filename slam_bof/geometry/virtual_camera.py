"""Projection of point clouds into the depth image of a virtual camera.

Everything after the odometry works on depth images. The cloud of a depth camera is projected into
such an image. For a sensor that sees all around, such as a LiDAR, the virtual camera is level and
keeps its direction *in the odometry frame* while the sensor turns. A place that is revisited in
the opposite direction therefore gives the same view, and the view changes from scan to scan only
because the sensor translates.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.geometry.camera import project
from slam_bof.geometry.gravity import level_frame
from slam_bof.types import Array, DepthFrame, Intrinsics, Params, Pose

__all__ = ["CloudCamera", "VirtualCameraParams", "VirtualView", "render"]

NEAR_M = 0.05
"""Points nearer than this are not projected."""


class VirtualCameraParams(Params):
    """Parameters of the depth images into which point clouds are projected."""

    max_angle_deg: float = Field(
        60.0,
        gt=0,
        lt=90,
        description="Largest angle between the optical axis and the border of the image.",
    )
    min_share_ahead: float = Field(
        0.9,
        ge=0,
        le=1,
        description="Smallest share of points within these angles for a sensor to count as a depth "
        "camera; other sensors are taken to see all around.",
    )
    margin: float = Field(
        1.02, ge=1, description="Factor by which the image is made wider than the points need."
    )
    quantile: float = Field(
        0.995,
        gt=0,
        le=1,
        description="Quantile of the slopes of the points that sets the width of the image.",
    )
    points_per_pixel: float = Field(
        1.5, gt=0, description="Mean number of points per pixel, which sets the resolution."
    )
    width_px: tuple[int, int] = Field(
        (160, 320), description="Smallest and largest width of the image, in pixels."
    )
    min_points: int = Field(
        100, gt=0, description="Smallest number of points from which the sensor is determined."
    )
    same_surface: float = Field(
        0.1, gt=0, description="Largest relative difference in depth of points on one surface."
    )
    max_gap_px: int = Field(
        6,
        ge=0,
        description="Largest gap between points of one surface that is closed, such as between the "
        "rings of a LiDAR.",
    )

    @property
    def max_tangent(self) -> float:
        """Tangent of the largest angle."""
        return float(np.tan(np.radians(self.max_angle_deg)))


class VirtualView(NamedTuple):
    """The depth image of a cloud, and the pose of the virtual camera in the sensor frame."""

    frame: DepthFrame
    T_camera_view: Pose


class CloudCamera:
    """Renders the clouds of one sensor, whose type is determined from the first cloud.

    Parameters
    ----------
    gravity_odom
        (3,) rough direction of gravity in the odometry frame.
    params
        Parameters of the virtual camera.
    """

    def __init__(
        self,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        params: VirtualCameraParams | None = None,
    ) -> None:
        self.params = params or VirtualCameraParams()
        self._R_odom_view = level_frame(np.asarray(gravity_odom, dtype=np.float64)).T
        self._intrinsics: Intrinsics | None = None
        self._is_around = False

    @property
    def is_around(self) -> bool | None:
        """Whether the sensor sees all around; None before the first cloud."""
        return None if self._intrinsics is None else self._is_around

    def restore(self, intrinsics: Intrinsics, is_around: bool) -> None:
        """Restore the virtual camera of a saved map."""
        self._intrinsics, self._is_around = intrinsics, is_around

    def observe(self, stamp_s: float, points_camera: Array, T_odom_camera: Pose) -> VirtualView:
        """Return the virtual view of a cloud.

        Parameters
        ----------
        stamp_s
            Time in seconds.
        points_camera
            (N, 3) in metres, x right, y down, z forward. Rows that are not finite are dropped.
        T_odom_camera
            (4, 4) pose of the sensor in the odometry frame.

        Raises
        ------
        ValueError
            If the points are not (N, 3).
        """
        points = np.asarray(points_camera)
        if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
            found = f"{points.shape} of {points.dtype}"
            raise ValueError(f"points_camera must be numbers (N, 3), got {found}")
        points = points[np.isfinite(points).all(axis=1)].astype(np.float64)
        if self._intrinsics is None and len(points) >= self.params.min_points:
            self._choose_camera(points, T_odom_camera)
        T_camera_view = self._T_camera_view(T_odom_camera)
        camera = self._intrinsics
        if camera is None:  # no cloud so far had enough points
            camera, points = _camera(np.ones(2), 1, self.params), np.empty((0, 3))
        depth_m = render(se3.transform(se3.inverse(T_camera_view), points), camera, self.params)
        return VirtualView(DepthFrame(stamp_s, depth_m, camera), T_camera_view)

    def _T_camera_view(self, T_odom_camera: Pose) -> Pose:
        if not self._is_around:
            return np.eye(4)
        R = np.asarray(T_odom_camera)[:3, :3].T @ self._R_odom_view
        return se3.pose(R, np.zeros(3))

    def _choose_camera(self, points: Array, T_odom_camera: Pose) -> None:
        """Choose the virtual camera from the extent and the density of a cloud."""
        p = self.params
        self._is_around = not _falls_ahead(points, p).mean() >= p.min_share_ahead
        R_view_camera = self._T_camera_view(T_odom_camera)[:3, :3].T
        ahead = points @ R_view_camera.T
        ahead = ahead[_falls_ahead(ahead, p)]
        if len(ahead) < p.min_points:  # a narrow sensor that points in another direction
            return
        slopes = np.abs(ahead[:, :2]) / ahead[:, 2:]
        tangents = p.margin * np.quantile(slopes, p.quantile, axis=0)
        self._intrinsics = _camera(np.minimum(tangents, p.max_tangent), len(ahead), p)


def render(
    points_view: Array, camera: Intrinsics, params: VirtualCameraParams | None = None
) -> NDArray[np.float32]:
    """Return the depth image (H, W) of points: float32 in metres, 0 where there are none.

    A pixel gets the mean inverse depth of its points on the nearest surface. Gaps of up to
    ``max_gap_px`` between points of one surface are closed by interpolating inverse depth, which
    is linear in the image of a plane.
    """
    p = params or VirtualCameraParams()
    inverse = np.zeros(camera.height * camera.width)
    ahead = points_view[points_view[:, 2] > NEAR_M]
    row, column, is_inside = project(ahead, camera)
    pixel, near = row * camera.width + column, 1.0 / ahead[is_inside, 2]
    np.maximum.at(inverse, pixel, near)
    front = near >= (1.0 - p.same_surface) * inverse[pixel]
    count = np.bincount(pixel[front], minlength=len(inverse))
    total = np.bincount(pixel[front], weights=near[front], minlength=len(inverse))
    image: Array = (total / np.maximum(count, 1)).reshape(camera.height, camera.width)
    for axis in (1, 0):
        image = _close_gaps(image, axis, p)
    depth_m = np.zeros_like(image)
    np.divide(1.0, image, out=depth_m, where=image > 0)
    return depth_m.astype(np.float32)


def _close_gaps(inverse: Array, axis: int, params: VirtualCameraParams) -> Array:
    """Interpolate linearly along an axis in the gaps between pixels of one surface."""
    lines = np.moveaxis(inverse, axis, -1)
    n = lines.shape[-1]
    at = np.where(lines > 0, np.arange(n), -1)
    before = np.maximum.accumulate(at, axis=-1)
    at = np.where(lines > 0, np.arange(n), n)
    after = np.minimum.accumulate(at[..., ::-1], axis=-1)[..., ::-1]
    first = np.take_along_axis(lines, np.maximum(before, 0), axis=-1)
    last = np.take_along_axis(lines, np.minimum(after, n - 1), axis=-1)
    gap = after - before
    is_closed = (lines == 0) & (before >= 0) & (after < n) & (gap <= params.max_gap_px + 1)
    is_closed &= np.abs(first - last) < params.same_surface * np.maximum(first, last)
    fraction = (np.arange(n) - before) / np.maximum(gap, 1)
    filled = np.where(is_closed, first + fraction * (last - first), lines)
    return np.moveaxis(filled, -1, axis)


def _falls_ahead(points: Array, params: VirtualCameraParams) -> NDArray[np.bool_]:
    x, y, z = points.T
    reach = params.max_tangent * z
    return np.asarray((z > NEAR_M) & (np.abs(x) < reach) & (np.abs(y) < reach))


def _camera(tangents: Array, n_points: int, params: VirtualCameraParams) -> Intrinsics:
    """Return a camera with square pixels and these tangents (2,) of its half angles, x and y."""
    across, along = (max(float(t), 0.05) for t in tangents)
    width = np.sqrt(n_points / params.points_per_pixel * across / along)
    width_px = 2 * round(float(np.clip(width, *params.width_px)) / 2)
    focal_px = 0.5 * width_px / across
    height_px = max(2 * round(focal_px * along), 2)
    return Intrinsics(
        width_px, height_px, focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2
    )
