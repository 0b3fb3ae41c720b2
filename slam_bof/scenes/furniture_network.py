"""What furniture a view shows: a small convolutional network on a levelled view.

Synthetic rooms are few against real ones in kind, but their pieces of furniture can be had in any
number, each pixel with its kind. The network learns these; what it sees in a view then helps to
tell the room (A. Handa et al., "SceneNet", CVPR 2016, learn the furniture of real depth images from
synthetic ones). ``furniture_training`` trains it with PyTorch; it runs with NumPy alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.special import softmax

from slam_bof.scenes.levelled_cloud import LevelledCloud

__all__ = ["CELL_PX", "IMAGE_SHAPE", "WIDTHS", "FurnitureNetwork", "furniture_image"]

Floats = NDArray[np.float32]

IMAGE_SHAPE = 6, 60, 80
"""Channels, height and width of the input; further pixels of a view are left out."""
CELL_PX = 4
"""Width of a cell, which the network names one piece of furniture for, in pixels of the input."""
WIDTHS = (24, 48, 64, 64)
"""Number of channels after each convolution."""
KERNELS, STRIDES, DILATIONS = (5, 3, 3, 3), (2, 2, 1, 1), (1, 1, 1, 2)
HEIGHTS_M = (-0.5, 3.0)
"""Heights beyond these are clipped."""
MIN_RANGE_M, LOG_RANGE = 0.4, 0.7
"""Least range, and the mean of its logarithm, which is taken off."""
MIN_DISTANCE_M = 0.1
"""Least horizontal distance that a direction is divided by."""
FLOOR_M = 0.05
"""A point counts as floor by a Gaussian of this deviation of its height."""
MAX_WEIGHT = 100.0
"""Largest weight in a model: sums over all layers must stay within 32 bits."""
MIN_WEIGHT = 1e-3
"""Added to the weight of all cells: a view without depth has none."""


def furniture_image(cloud: LevelledCloud) -> Floats:
    """Return the input ``IMAGE_SHAPE`` of the network.

    Its channels are the height above the floor (less 1), the upward component of the normal, the
    logarithm of the range, how much a surface faces the camera in plan, whether there is depth, and
    how near the point is to the floor. They are 0 where nothing is known.
    """
    points, normals = cloud.grid_points, cloud.grid_normals
    range_m = np.linalg.norm(points, axis=-1)
    known = (range_m > 0).astype(np.float32)
    height_m = cloud.camera_height_m - points[..., 1]
    distance_m = np.hypot(points[..., 0], points[..., 2])
    inward = -(normals[..., 0] * points[..., 0] + normals[..., 2] * points[..., 2])
    channels = np.stack(
        [
            (np.clip(height_m, *HEIGHTS_M) - 1.0) * known,
            -normals[..., 1],
            (np.log(np.maximum(range_m, MIN_RANGE_M)) - LOG_RANGE) * known,
            inward / np.maximum(distance_m, MIN_DISTANCE_M),
            known,
            np.exp(-((height_m / FLOOR_M) ** 2)) * known,
        ]
    )
    image = np.zeros(IMAGE_SHAPE, np.float32)
    rows, columns = np.minimum(channels.shape[1:], IMAGE_SHAPE[1:])
    image[:, :rows, :columns] = channels[:, :rows, :columns]
    return image


@dataclass(frozen=True, slots=True, eq=False)
class FurnitureNetwork:
    """Weights of four convolutions, of the furniture of a cell, and of the room that a view shows.

    ``kernel_k`` (O, C, k, k) and ``bias_k`` (O,) are of the k-th convolution, ``piece`` (P, O) and
    ``piece_bias`` (P,) of the kinds of furniture, ``room`` (R, 2 O) and ``room_bias`` (R,) of the
    kinds of rooms by mean and maximum over all cells.
    """

    kernel_0: Floats
    bias_0: Floats
    kernel_1: Floats
    bias_1: Floats
    kernel_2: Floats
    bias_2: Floats
    kernel_3: Floats
    bias_3: Floats
    piece: Floats
    piece_bias: Floats
    room: Floats
    room_bias: Floats

    @property
    def n_values(self) -> int:
        """Number of values that describe a view."""
        return int(2 * len(self.piece) + self.room.shape[1] + len(self.room))

    def describe(self, cloud: LevelledCloud) -> Floats:
        """Return what the network sees in a view, (n_values,).

        In this order: the root of the share of cells that show each kind of furniture, and how
        certain the surest cell is of it; mean and maximum of the last convolution; the logits of
        the kinds of rooms.
        """
        image = furniture_image(cloud)
        known = image[4].reshape(IMAGE_SHAPE[1] // CELL_PX, CELL_PX, -1, CELL_PX).mean(axis=(1, 3))
        weight = known.ravel() / (known.sum() + MIN_WEIGHT)
        layer = image
        for k, (stride, dilation) in enumerate(zip(STRIDES, DILATIONS, strict=True)):
            kernel, bias = getattr(self, f"kernel_{k}"), getattr(self, f"bias_{k}")
            layer = _convolve(layer, kernel, bias, stride, dilation)
        cells = layer.reshape(len(layer), -1)
        seen = weight > 0
        pieces = softmax(self.piece @ cells + self.piece_bias[:, None], axis=0) * seen
        pooled = np.concatenate([cells @ weight, (cells * seen).max(axis=1)])
        rooms = self.room @ pooled + self.room_bias
        shares = np.sqrt(pieces @ weight)
        return np.concatenate([shares, pieces.max(axis=1), pooled, rooms], dtype=np.float32)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return the weights by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[Any]]) -> Self:
        """Restore a network; ``KeyError`` or ``ValueError`` if its weights do not fit together."""
        n_channels = IMAGE_SHAPE[0]
        shapes: dict[str, tuple[int, ...]] = {}
        for k, (width, size) in enumerate(zip(WIDTHS, KERNELS, strict=True)):
            shapes[f"kernel_{k}"] = (width, n_channels, size, size)
            shapes[f"bias_{k}"] = (width,)
            n_channels = width
        for name, n_inputs in (("piece", n_channels), ("room", 2 * n_channels)):
            n_outputs = len(arrays[name])
            shapes |= {name: (n_outputs, n_inputs), f"{name}_bias": (n_outputs,)}
        for name, shape in shapes.items():
            if arrays[name].shape != shape:
                raise ValueError(f"{name} must be {shape}, got {arrays[name].shape}")
            if (largest := float(np.abs(arrays[name]).max())) > MAX_WEIGHT:
                raise ValueError(f"{name}: found {largest:g}, expected {MAX_WEIGHT:g} at most")
        return cls(**{name: arrays[name].astype(np.float32) for name in shapes})


def _convolve(image: Floats, kernel: Floats, bias: Floats, stride: int, dilation: int) -> Floats:
    """Return the positive part of a convolution of an image (C, h, w), zero beyond its border."""
    size = kernel.shape[-1]
    margin, span = dilation * (size // 2), dilation * (size - 1) + 1
    padded = np.pad(image, ((0, 0), (margin, margin), (margin, margin)))
    windows = sliding_window_view(padded, (span, span), axis=(1, 2))
    windows = windows[:, ::stride, ::stride, ::dilation, ::dilation]
    rows, columns = windows.shape[1:3]
    inputs = windows.transpose(0, 3, 4, 1, 2).reshape(-1, rows * columns)
    summed = kernel.reshape(len(kernel), -1) @ inputs + bias[:, None]
    return np.asarray(np.maximum(summed, 0.0).reshape(len(kernel), rows, columns), np.float32)
