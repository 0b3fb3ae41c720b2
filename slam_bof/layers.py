"""Points to binary images of layers (paper, section 3.2, both equations)."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from slam_bof.types import Params

__all__ = ["LayerParams", "layer_images", "layer_index"]

OPTICAL_AXIS = (0.0, 0.0, 1.0)


class LayerParams(Params):
    """How a cloud is cut, and how each layer is drawn.

    The paper rounds to the nearest index, which makes ``n_layers + 1`` layers with ends of
    half a width (``rounding="nearest"``); the default takes the floor, with the last layer
    closed, so that exactly ``n_layers`` equal layers hold every point once.
    """

    n_layers: int = Field(20, gt=0, le=65535, description="L: equal layers along the axis")
    resolution_px: int = Field(300, gt=1, description="R: side of a layer's image")
    rounding: Literal["floor", "nearest"] = "floor"
    axis: tuple[float, float, float] = Field(
        OPTICAL_AXIS, description="direction in the camera frame that the layers follow"
    )

    @field_validator("axis")
    @classmethod
    def _check_axis(cls, axis: tuple[float, float, float]) -> tuple[float, float, float]:
        length = float(np.linalg.norm(axis))
        if not np.isfinite(length) or length == 0.0:
            raise ValueError(f"axis must be a direction, got {axis}")
        return axis

    @property
    def n_images(self) -> int:
        """Number of layers that the rounding makes."""
        return self.n_layers + (self.rounding == "nearest")


def layer_index(points: NDArray[Any], params: LayerParams) -> NDArray[np.intp]:
    """Return the layer of each point (paper, 3.2, first equation).

    With ``h = axis . p``, ``m = min h``, ``delta = (max h - m) / L`` the index is
    ``floor((h - m) / delta)``, at most ``L - 1``. Points without extent along the axis are
    all in layer 0.

    Parameters
    ----------
    points
        (N, 3) float32 or float64 ``points_camera``, in metres.

    Returns
    -------
    NDArray[np.intp]
        (N,) in ``0 .. params.n_images - 1``.

    Examples
    --------
    >>> heights = np.array([0.0, 0.9, 1.0, 2.0])
    >>> points = np.stack([heights, heights, heights], axis=1)
    >>> layer_index(points, LayerParams(n_layers=2)).tolist()
    [0, 0, 1, 1]
    """
    _check_points(points)
    return _layer_index(points, params).astype(np.intp)


def layer_images(points: NDArray[Any], params: LayerParams) -> NDArray[np.uint8]:
    """Draw each layer's points as a binary image (paper, 3.2, second equation).

    The points are projected on the plane perpendicular to the camera's roll axis, (x, y).
    With ``delta_x = (x_max - x_min) / (R - 1)`` of the layer, likewise ``delta_y``, pixel
    ``(round((x - x_min) / delta_x), round((y - y_min) / delta_y))`` is 1. A layer without
    extent in x is one column, without extent in y one row, and without points empty.

    Parameters
    ----------
    points
        (N, 3) float32 or float64 ``points_camera``, in metres.

    Returns
    -------
    NDArray[np.uint8]
        (n_images, R, R), rows y, columns x, 0 or 1.
    """
    _check_points(points)
    size = params.resolution_px
    images = np.zeros((params.n_images, size, size), np.uint8)
    if len(points) == 0:
        return images
    index = _layer_index(points, params)
    # Sorted by layer, each layer is one run; 16-bit keys sort by radix, in linear time.
    order = np.argsort(index, kind="stable")
    counts = np.bincount(index, minlength=params.n_images)
    layers = np.flatnonzero(counts)
    counts = counts[layers]
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    columns = _pixels(points[:, 0][order], starts, counts, size)
    rows = _pixels(points[:, 1][order], starts, counts, size)
    pixels = rows * size + columns + np.repeat(layers.astype(np.int32) * (size * size), counts)
    images.reshape(-1)[pixels] = 1
    return images


def _check_points(points: NDArray[Any]) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must be (N, 3), got {points.shape}")


def _layer_index(points: NDArray[Any], params: LayerParams) -> NDArray[np.uint16]:
    if len(points) == 0:
        return np.zeros(0, np.uint16)
    height = _heights(points, params.axis)
    lowest, highest = height.min(), height.max()
    delta = (highest - lowest) / height.dtype.type(params.n_layers)
    if not delta > 0:
        return np.zeros(len(points), np.uint16)
    scaled = (height - lowest) / delta
    if params.rounding == "nearest":
        scaled += height.dtype.type(0.5)
    # Truncation is floor here, as nothing is negative.
    index: NDArray[np.uint16] = scaled.astype(np.uint16)
    return np.minimum(index, np.uint16(params.n_images - 1))


def _heights(points: NDArray[Any], axis: tuple[float, float, float]) -> NDArray[Any]:
    """Return ``axis . p`` of every point, in the points' own precision."""
    if axis == OPTICAL_AXIS:
        return np.ascontiguousarray(points[:, 2])
    unit = np.asarray(axis) / np.linalg.norm(axis)
    heights: NDArray[Any] = points @ unit.astype(points.dtype)
    return heights


def _pixels(
    values: NDArray[Any], starts: NDArray[np.intp], counts: NDArray[np.intp], size: int
) -> NDArray[np.int32]:
    """Spread each run of values over 0 .. size - 1, rounding half up."""
    lowest = np.minimum.reduceat(values, starts)
    delta = (np.maximum.reduceat(values, starts) - lowest) / values.dtype.type(size - 1)
    # A run without extent has value - lowest = 0 everywhere: any delta sends it to pixel 0.
    delta[~(delta > 0)] = 1
    scaled = (values - np.repeat(lowest, counts)) / np.repeat(delta, counts)
    scaled += values.dtype.type(0.5)
    pixels: NDArray[np.int32] = scaled.astype(np.int32)
    return pixels
