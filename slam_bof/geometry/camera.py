"""Projection, and back-projection: ``p = ((u - cx) z / fx, (v - cy) z / fy, z)`` (paper, 3.2)."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from slam_bof.core import compiled
from slam_bof.errors import DatasetError
from slam_bof.types import Array, DepthFrame, Intrinsics, Params

__all__ = [
    "PointParams",
    "back_project",
    "checked_depth",
    "checked_intrinsics",
    "points_camera",
    "points_camera_f32",
    "project",
    "ray_slopes",
]

MAX_DEPTH_M = 1000.0
"""Depth beyond this is a value that means something else; the range of a sensor ends far before."""


class PointParams(Params):
    """Parameters of the selection of pixels that become points."""

    stride: int = Field(2, gt=0, description="Step between the pixels used, in rows and columns.")
    min_range_m: float = Field(0.1, ge=0, description="Smallest depth used.")
    max_range_m: float = Field(8.0, gt=0, description="Largest depth used.")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if self.min_range_m >= self.max_range_m:
            raise ValueError(
                f"min_range_m must be below max_range_m, got {self.min_range_m} and "
                f"{self.max_range_m}"
            )
        return self


def checked_depth(
    where: Path | str, depth_m: NDArray[Any], *, is_unit_known: bool = True
) -> NDArray[Any]:
    """Return a depth image that a file gives in metres, with 0 where it is farther than 1 km.

    Without ``is_unit_known``, an image that is mostly farther is returned as it is: then the unit
    is probably another, of which a run warns.

    Raises
    ------
    DatasetError
        If it is nowhere nearer, but is not empty: its unit is another, or it is no depth.
    """
    if depth_m.dtype == np.uint16:
        return depth_m  # millimetres, which end at 65 m
    is_known = np.isfinite(depth_m) & (depth_m > 0.0)
    is_far = is_known & (depth_m > MAX_DEPTH_M)
    n_far, n_known = np.count_nonzero(is_far), np.count_nonzero(is_known)
    if n_far == 0 or (not is_unit_known and n_far > n_known / 2):
        return depth_m
    if n_far == n_known:
        raise DatasetError(
            f"{where}: found depths from {depth_m[is_far].min():g} m, expected some within "
            f"{MAX_DEPTH_M:g} m: is the unit right?"
        )
    return np.where(is_far, np.float32(0.0), depth_m)


def checked_intrinsics(
    where: Path | str, width: int, height: int, fx: float, fy: float, cx: float, cy: float
) -> Intrinsics:
    """Return the intrinsics that a file or an option gives; ``DatasetError`` names it.

    Raises
    ------
    DatasetError
        If ``Intrinsics`` refuses the numbers; the message begins with ``where``.
    """
    try:
        return Intrinsics(width, height, fx, fy, cx, cy)
    except ValueError as error:
        raise DatasetError(f"{where}: {error}; are these intrinsics of another camera?") from None


def back_project(depth_m: NDArray[Any], intrinsics: Intrinsics, stride: int = 1) -> Array:
    """Return the points of a depth image.

    Parameters
    ----------
    depth_m
        (ceil(height / stride), ceil(width / stride)) depth in metres, 0 where missing, as returned
        by ``DepthFrame.depth_m(stride)``.
    intrinsics
        Intrinsics of the full image.
    stride
        Number of pixels of the full image per entry of ``depth_m``, in each direction.

    Returns
    -------
    Array
        (N, 3) float64 ``points_camera`` of the valid pixels, in row-major order.

    Raises
    ------
    ValueError
        If the shape of ``depth_m`` does not match the intrinsics and the stride.

    Examples
    --------
    >>> camera = Intrinsics(width=3, height=1, fx=2.0, fy=2.0, cx=1.0, cy=0.0)
    >>> back_project(np.array([[4.0, 0.0, 2.0]]), camera).tolist()
    [[-2.0, 0.0, 4.0], [1.0, 0.0, 2.0]]
    """
    x_per_z, y_per_z = ray_slopes(intrinsics, stride)
    expected = (len(y_per_z), len(x_per_z))
    if depth_m.shape != expected:
        raise ValueError(
            f"depth_m must be {expected} at stride {stride} for its intrinsics, got {depth_m.shape}"
        )
    depth = depth_m.astype(np.float64)
    # The slopes of the rays are the same in every row and in every column.
    points = np.stack([depth * x_per_z, depth * y_per_z[:, None], depth], axis=-1)
    found: Array = points[depth > 0]
    return found


def points_camera(frame: DepthFrame, params: PointParams) -> Array:
    """Return the frame's points, (N, 3) float64, within this range and that of its sensor."""
    depth_m = frame.depth_in_range_m(params.stride)
    depth_m[(depth_m < params.min_range_m) | (depth_m > params.max_range_m)] = 0.0
    return back_project(depth_m, frame.intrinsics, params.stride)


def points_camera_f32(frame: DepthFrame, params: PointParams) -> NDArray[np.float32]:
    """Return the same points as ``points_camera`` in single precision, for BOF descriptors.

    The result is (N, 3) float32 with contiguous columns, which suits the computation of layers.
    """
    x_per_z, y_per_z = ray_slopes(frame.intrinsics, params.stride)
    return _points_f32(
        frame.depth_m(params.stride),
        x_per_z.astype(np.float32),
        y_per_z.astype(np.float32),
        np.float32(max(params.min_range_m, frame.sensor.min_depth_m)),
        np.float32(min(params.max_range_m, frame.sensor.max_depth_m)),
    ).T


@compiled
def _points_f32(
    depth_m: NDArray[np.float32],
    x_per_z: NDArray[np.float32],
    y_per_z: NDArray[np.float32],
    min_range_m: np.float32,
    max_range_m: np.float32,
) -> NDArray[np.float32]:
    """Return the points (3, N) of the pixels in range."""
    points = np.empty((3, depth_m.size), np.float32)
    n = 0
    for row in range(depth_m.shape[0]):
        for column in range(depth_m.shape[1]):
            z = depth_m[row, column]
            if z > 0 and min_range_m <= z <= max_range_m:
                points[0, n] = z * x_per_z[column]
                points[1, n] = z * y_per_z[row]
                points[2, n] = z
                n += 1
    return points[:, :n]


def project(
    points_camera: Array, intrinsics: Intrinsics
) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.bool_]]:
    """Return the pixels in which points lie.

    Parameters
    ----------
    points_camera
        (N, 3) points.
    intrinsics
        Intrinsics of the image.

    Returns
    -------
    rows, columns : NDArray[np.intp]
        (M,) pixels of the points within the image.
    is_inside : NDArray[np.bool_]
        (N,) which points these are.

    Examples
    --------
    >>> camera = Intrinsics(width=3, height=1, fx=2.0, fy=2.0, cx=1.0, cy=0.0)
    >>> rows, columns, is_inside = project(np.array([[1.0, 0.0, 2.0], [9.0, 0.0, 2.0]]), camera)
    >>> rows.tolist(), columns.tolist(), is_inside.tolist()
    ([0], [2], [True, False])
    """
    x, y, z = points_camera.T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        column = np.rint(intrinsics.fx * x / z + intrinsics.cx)
        row = np.rint(intrinsics.fy * y / z + intrinsics.cy)
    is_inside = (z > 0) & (column >= 0) & (column < intrinsics.width)
    is_inside &= (row >= 0) & (row < intrinsics.height)
    return row[is_inside].astype(np.intp), column[is_inside].astype(np.intp), is_inside


def ray_slopes(intrinsics: Intrinsics, stride: int = 1) -> tuple[Array, Array]:
    """Return x / z of every ``stride``-th column and y / z of every ``stride``-th row."""
    columns = np.arange(0, intrinsics.width, stride, dtype=np.float64)
    rows = np.arange(0, intrinsics.height, stride, dtype=np.float64)
    return (columns - intrinsics.cx) / intrinsics.fx, (rows - intrinsics.cy) / intrinsics.fy
