"""Points to binary images of layers (paper, section 3.2, both equations)."""

from __future__ import annotations

from typing import Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from slam_bof.bof.bit_images import n_words, set_bit, unpack_bits
from slam_bof.core import compiled
from slam_bof.types import Array, Params

__all__ = ["LayerParams", "draw_layers", "layer_images", "layer_index"]

OPTICAL_AXIS = (0.0, 0.0, 1.0)
MAX_PIXELS = 2**30
BLOCK = 512


class LayerParams(Params):
    """How a point cloud is cut into layers, and how each layer is drawn.

    The paper rounds to the nearest index, which makes ``n_layers + 1`` layers with ends of
    half a width (``rounding="nearest"``); the default takes the floor, with the last layer
    closed, so that exactly ``n_layers`` equal layers hold every point once.

    Beyond the paper, ``thickness_m`` and ``pixel_m`` fix the scale, so that an object looks the
    same whatever else the frame shows: layer l then begins at ``start_m + l thickness_m``, and the
    camera is at the image's centre. Points outside are not drawn.
    """

    n_layers: int = Field(
        20, gt=0, le=65534, description="Number of layers along the axis (the paper's L)."
    )
    resolution_px: int = Field(
        300, gt=1, description="Side of a layer's image in pixels (the paper's R)."
    )
    rounding: Literal["floor", "nearest"] = Field(
        "floor",
        description="Rounding of the layer index: floor makes n_layers equal layers; nearest "
        "makes n_layers + 1, as in the paper, of which the first and the last are "
        "half as thick.",
    )
    axis: tuple[float, float, float] | Literal["gravity"] = Field(
        OPTICAL_AXIS,
        description="Direction along which layers are cut, in the camera frame; gravity for the "
        "measured vertical.",
    )
    plane: Literal["camera", "axis"] = Field(
        "camera",
        description="Plane that a layer is projected on: perpendicular to the optical axis "
        "(camera) or to the layers' axis (axis).",
    )
    thickness_m: float | None = Field(
        None,
        gt=0,
        description="Thickness of a layer in metres; none divides the extent of the cloud into "
        "n_layers.",
    )
    start_m: float = Field(
        0.0,
        description="Position along the axis at which layers of fixed thickness begin, in metres.",
    )
    pixel_m: float | None = Field(
        None,
        gt=0,
        description="Side of a pixel in metres; none fits the extent of each layer to the image.",
    )

    @field_validator("axis")
    @classmethod
    def _check_axis(cls, axis: Any) -> Any:
        if axis != "gravity":
            _unit(np.asarray(axis))
        return axis

    @model_validator(mode="after")
    def _check_size(self) -> Self:
        # Pixels are counted through all layers in 32 bits; half of them leaves room for margins.
        if self.n_layers * self.resolution_px**2 > MAX_PIXELS:
            raise ValueError(
                f"n_layers images of resolution_px must have at most {MAX_PIXELS} pixels together, "
                f"got {self.n_layers} of {self.resolution_px} x {self.resolution_px}"
            )
        return self

    @model_validator(mode="after")
    def _check_rounding(self) -> Self:
        if self.rounding == "nearest" and self.thickness_m is not None:
            raise ValueError("rounding 'nearest' is for layers without thickness_m")
        return self

    @property
    def n_images(self) -> int:
        """Number of layers that the rounding makes."""
        return self.n_layers + (self.rounding == "nearest")


def layer_index(
    points: NDArray[Any], params: LayerParams, *, gravity_camera: Array | None = None
) -> NDArray[np.intp]:
    """Return the layer of each point (paper, 3.2, first equation).

    With ``h = axis . p``, ``m = min h``, ``delta = (max h - m) / L`` the index is
    ``floor((h - m) / delta)``, at most ``L - 1``. Points without extent along the axis are
    all in layer 0. With ``thickness_m`` it is ``floor((h - start_m) / thickness_m)``.

    Parameters
    ----------
    points
        (N, 3) float32 or float64 ``points_camera``, in metres.
    gravity_camera
        (3,), the direction down in the camera frame, for ``axis="gravity"``.

    Returns
    -------
    NDArray[np.intp]
        (N,) in ``0 .. params.n_images - 1``; -1 where no layer of fixed thickness is.

    Examples
    --------
    >>> heights = np.array([0.0, 0.9, 1.0, 2.0])
    >>> points = np.stack([heights, heights, heights], axis=1)
    >>> layer_index(points, LayerParams(n_layers=2)).tolist()
    [0, 0, 1, 1]
    """
    _check_points(points)
    _, _, height = _coordinates(points, params, gravity_camera)
    index = _layer_index(height, params).astype(np.intp)
    return np.where(index < params.n_images, index, -1)


def layer_images(
    points: NDArray[Any],
    params: LayerParams,
    *,
    gravity_camera: Array | None = None,
    margin_px: int = 0,
) -> NDArray[np.uint8]:
    """Draw each layer's points as a binary image (paper, 3.2, second equation).

    The points are projected on the plane perpendicular to the camera's roll axis, (x, y).
    With ``delta_x = (x_max - x_min) / (R - 1)`` of the layer, likewise ``delta_y``, pixel
    ``(round((x - x_min) / delta_x), round((y - y_min) / delta_y))`` is 1. A layer without
    extent in x is one column, without extent in y one row, and without points empty. With
    ``pixel_m`` both deltas are that, and the camera is in the middle of the image.

    Parameters
    ----------
    points
        (N, 3) float32 or float64 ``points_camera``, in metres; quickest with contiguous columns.
    gravity_camera
        (3,), the direction down in the camera frame, for ``axis="gravity"``.
    margin_px
        Empty pixels around each image, which ``find_contours`` needs for its closing.

    Returns
    -------
    NDArray[np.uint8]
        (n_images, R + 2 margin, R + 2 margin), rows y, columns x, 0 or 1.

    Raises
    ------
    ValueError
        If the points are not (N, 3), or ``axis="gravity"`` has no ``gravity_camera``.
    """
    words = draw_layers(points, params, gravity_camera=gravity_camera, margin_px=margin_px)
    return unpack_bits(words, params.resolution_px + 2 * margin_px)


def draw_layers(
    points: NDArray[Any],
    params: LayerParams,
    *,
    gravity_camera: Array | None = None,
    margin_px: int = 0,
) -> NDArray[np.uint32]:
    """Return the same images as ``layer_images``, as words of bits (``bit_images``)."""
    _check_points(points)
    side = params.resolution_px + 2 * margin_px
    words = np.zeros((params.n_images, side, n_words(side)), np.uint32)
    x, y, height = map(np.ascontiguousarray, _coordinates(points, params, gravity_camera))
    index = _layer_index(height, params)
    shift = height.dtype.type(0 if params.pixel_m is None else params.resolution_px // 2)
    scales = *_scale(x, index, params), *_scale(y, index, params)
    _draw(x, y, index, *scales, shift, height.dtype.type(0.5), margin_px, words)
    return words


def _check_points(points: NDArray[Any]) -> None:
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points must be (N, 3), got {points.shape}")


def _coordinates(
    points: NDArray[Any], params: LayerParams, gravity_camera: Array | None
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Return x and y on the plane that is drawn, and the height along the axis."""
    x, y, z = points.T
    if params.axis == OPTICAL_AXIS:
        return x, y, z
    if params.axis != "gravity":
        unit = _unit(np.asarray(params.axis))
    elif gravity_camera is None:
        raise ValueError("layers along gravity need gravity_camera, got none")
    else:
        unit = _unit(np.asarray(gravity_camera))
    height = points @ unit.astype(points.dtype)
    if params.plane == "axis":
        x, y = _across(unit).astype(points.dtype) @ points.T
    return x, y, height


def _unit(axis: Array) -> Array:
    length = float(np.linalg.norm(axis))
    if axis.shape != (3,) or not np.isfinite(length) or length == 0.0:
        raise ValueError(f"axis must be a direction, got {tuple(axis.tolist())}")
    unit: Array = axis / length
    return unit


def _across(unit: Array) -> Array:
    """Return two directions (2, 3) across an axis; x and y for the optical axis.

    The rotation that takes the optical axis to the given one by the shortest way takes x and y
    along; for the axis opposite, which has no shortest way, it is half a turn about x.
    """
    a, b, c = unit
    if c <= -1.0 + 1e-9:
        return np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
    k = 1.0 / (1.0 + c)
    return np.array([[1.0 - a * a * k, -a * b * k, -a], [-a * b * k, 1.0 - b * b * k, -b]])


def _layer_index(height: NDArray[Any], params: LayerParams) -> NDArray[Any]:
    """Return the layer of each height (N,) uint16, ``n_images`` for those in none."""
    dtype = height.dtype.type
    last = params.n_images - 1
    if params.thickness_m is None:
        lowest = height.min(initial=np.inf)
        delta = (height.max(initial=-np.inf) - lowest) / dtype(params.n_layers)
    else:
        lowest, delta = dtype(params.start_m), dtype(params.thickness_m)
        last += 1
    if not delta > 0:
        return np.zeros_like(height, np.uint16)
    half = dtype(0.5 if params.rounding == "nearest" else 0.0)
    below = last if params.thickness_m is not None else 0
    return _cut(height, lowest, delta, half, below, last)


@compiled
def _cut(
    height: NDArray[Any],
    lowest: np.floating[Any],
    delta: np.floating[Any],
    half: np.floating[Any],
    below: int,
    last: int,
) -> NDArray[np.uint16]:
    """Return the layer of each height, ``below`` for those below the lowest, at most ``last``."""
    index = np.empty(len(height), np.uint16)
    for i in range(len(height)):
        scaled = (height[i] - lowest) / delta + half
        if scaled < 0:
            index[i] = below
        else:
            index[i] = last if scaled >= last else int(scaled)
    return index


def _scale(
    values: NDArray[Any], index: NDArray[np.uint16], params: LayerParams
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the value that is drawn at 0 and the size of a pixel, (n_images + 1,) each."""
    n, dtype = params.n_images + 1, values.dtype.type
    if params.pixel_m is not None:
        return np.zeros(n, dtype), np.full(n, params.pixel_m, dtype)
    low, high = _extents(values, index, n)
    step = (high - low) / dtype(params.resolution_px - 1)
    # In a layer without extent value - low = 0 everywhere: any step sends it to pixel 0.
    step[~(step > 0)] = 1
    return low, step


@compiled
def _extents(
    values: NDArray[Any], index: NDArray[np.uint16], n: int
) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return the lowest and the highest value (n,) of each layer, infinity if it has none."""
    low, high = np.full(n, np.inf, values.dtype), np.full(n, -np.inf, values.dtype)
    for i in range(len(values)):
        k = index[i]
        if values[i] < low[k]:
            low[k] = values[i]
        if values[i] > high[k]:
            high[k] = values[i]
    return low, high


@compiled
def _draw(
    x: NDArray[Any],
    y: NDArray[Any],
    index: NDArray[np.uint16],
    x_low: NDArray[Any],
    x_step: NDArray[Any],
    y_low: NDArray[Any],
    y_step: NDArray[Any],
    shift: np.floating[Any],
    half: np.floating[Any],
    margin: int,
    words: NDArray[np.uint32],
) -> None:
    """Set the pixel of each point in its layer, rounding half up.

    Some points at a time are scaled without branches, by vector instructions, and then set.
    """
    n_images, side, width = words.shape
    size = np.float32(side - 2 * margin)
    sheet = words.reshape(n_images * side, width)
    columns, rows = np.empty(BLOCK, x.dtype), np.empty(BLOCK, y.dtype)
    for start in range(0, len(x), BLOCK):
        n = min(BLOCK, len(x) - start)
        xs, ys, layers = x[start : start + n], y[start : start + n], index[start : start + n]
        for i in range(n):
            k = layers[i]
            columns[i] = (xs[i] - x_low[k]) / x_step[k] + shift + half
            rows[i] = (ys[i] - y_low[k]) / y_step[k] + shift + half
        for i in range(n):
            column, row, k = columns[i], rows[i], layers[i]
            if k < n_images and 0 <= column < size and 0 <= row < size:
                set_bit(sheet, k * side + margin + int(row), margin + int(column))
