"""Cells of what contours look like, by which they are looked up: slice, size, shape and mean."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs

__all__ = ["contour_keys", "key_ranges"]

LOG_SMALLEST = np.log(0.1)
"""Logarithm of the size, in m, at which the first cell begins."""
CELL_WIDTHS = np.array([0.2, 0.07, 0.07], np.float32)
"""Width of a cell in the logarithm of the size, and in the magnitudes of the second and third
harmonic."""
N_CELLS = np.array([24, 8, 5])
"""Number of cells along each of these; what lies beyond the last is in the last."""
MEAN_LEVELS = 256
"""Number of levels to which the mean radius, in [0, 1], is rounded."""
MEAN_REACH = 15
"""Number of levels by which the means of two contours that match may differ."""


def contour_keys(bofs: PlacedBofs, levels: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return the keys of contours (C,), whose means are at ``levels`` (C,) of 256."""
    shape = np.clip(np.floor(_shape(bofs)), 0, N_CELLS - 1).astype(np.int64)
    return (_first_key(bofs.slices, shape) + levels).astype(np.int32)


def key_ranges(
    query: PlacedBofs, slices_apart: Sequence[int]
) -> tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.int32]]:
    """Return contours (R,) and ranges of keys (R,), (R,) to look each up in.

    ``slices_apart`` are the differences between the slices that are looked in and a contour's own.
    Along each axis of its shape, the two nearest cells are looked in.
    """
    at = np.clip(_shape(query), 0, N_CELLS - 0.01)
    beside = np.array(list(product(slices_apart, *[(0, 1)] * len(N_CELLS))))
    shape = np.floor(at - 0.5).astype(np.int64) + beside[:, None, 1:]
    slices = query.slices.astype(np.int64) + beside[:, None, 0]
    inside = (slices >= 0) & ((shape >= 0) & (shape < N_CELLS)).all(axis=-1)
    contours = np.nonzero(inside)[1]
    first = _first_key(slices[inside], shape[inside])
    level = np.rint(query.means * (MEAN_LEVELS - 1)).astype(np.int64)
    low = np.maximum(level - MEAN_REACH, 0)
    high = np.minimum(level + MEAN_REACH + 1, MEAN_LEVELS)
    # Of the type of the keys, which would be converted otherwise.
    low, high = ((first + level[contours]).astype(np.int32) for level in (low, high))
    # In order, each search goes on where the one before has been.
    order = np.argsort(low, kind="stable")
    return contours[order], low[order], high[order]


def _shape(bofs: PlacedBofs) -> NDArray[np.float32]:
    """Return what cells are made of, in widths of cells: size and two magnitudes, (C, 3)."""
    half = N_HARMONICS
    magnitudes = np.hypot(bofs.codes[:, 2:4], bofs.codes[:, half + 2 : half + 4])
    size = bofs.log_radii - np.float32(LOG_SMALLEST)
    return np.asarray(np.concatenate([size[:, None], magnitudes], axis=1) / CELL_WIDTHS)


def _first_key(slices: NDArray[np.integer[Any]], shape: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first key of cells (C,) of slice (C,) and shape (C, 3)."""
    key = slices.astype(np.int64)
    for n_cells, along in zip(N_CELLS, shape.T, strict=True):
        key = key * n_cells + along
    return key * MEAN_LEVELS
