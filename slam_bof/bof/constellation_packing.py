"""Constellations in few bytes: 32 for each contour, to keep in an index, with a map or on disk.

The low harmonics of a BOF's spectrum, which tell nearly all, are rounded to 8 bits each, as
``compression`` does. Places are rounded to 8 mm, sizes to 2 % and lengths to 3 %.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import N_HARMONICS, PlacedBofs

__all__ = [
    "PACKED",
    "STEPS_PER_M",
    "pack_constellation",
    "packed_places",
    "unpack_constellation",
]

PACKED = np.dtype(
    [
        ("code", np.int8, 2 * N_HARMONICS),
        ("place", "<i2", 2),
        ("slice", np.int8),
        ("mean", np.uint8),
        ("log_radius", np.uint8),
        ("log_length", np.uint8),
    ]
)
"""A contour as it is kept."""

STEPS_PER_M = 128
"""Number of steps of a place in a metre."""
_CODE_SCALE = np.full(2 * N_HARMONICS, 127 / 0.5, np.float32)
_CODE_SCALE[0] = 127.0  # the mean, which is nearly all of a code's length
_LOG_RADIUS = (np.log(np.float32(0.05)), np.float32(0.02))
_LOG_LENGTH = (np.log(np.float32(0.05)), np.float32(0.03))
"""The lowest logarithm that is kept of a size and of a length in m, and the step between two."""


def pack_constellation(bofs: PlacedBofs) -> NDArray[np.void]:
    """Return the contours as rows (C,) of ``PACKED``; their bytes are ``.tobytes()``."""
    rows = np.zeros(len(bofs.slices), PACKED)
    rows["code"] = np.clip(np.rint(bofs.codes * _CODE_SCALE), -127, 127)
    place = np.stack([bofs.centroids_m.real, bofs.centroids_m.imag], axis=1)
    rows["place"] = np.rint(place * STEPS_PER_M)
    rows["slice"] = bofs.slices
    rows["mean"] = np.rint(bofs.means * 255)
    for name, logarithm, (lowest, step) in (
        ("log_radius", bofs.log_radii, _LOG_RADIUS),
        ("log_length", np.log(bofs.lengths_m), _LOG_LENGTH),
    ):
        rows[name] = np.clip(np.rint((logarithm - lowest) / step), 0, 255)
    return rows


def packed_places(rows: NDArray[np.void]) -> NDArray[np.int32]:
    """Return the places (C,) of packed contours, x in the lower 16 bits and z in the upper ones."""
    return np.ascontiguousarray(rows["place"]).view(np.int32)[:, 0]


def unpack_constellation(rows: NDArray[np.void]) -> PlacedBofs:
    """Return the contours that were packed, but for rounding.

    >>> bofs = PlacedBofs(
    ...     np.array([14], np.int8),
    ...     np.array([0.5 + 2j], np.complex64),
    ...     np.log(np.array([0.4], np.float32)),
    ...     np.array([0.8], np.float32),
    ...     np.array([2.5], np.float32),
    ...     np.eye(1, 2 * N_HARMONICS, dtype=np.float32),
    ... )
    >>> rows = pack_constellation(bofs)
    >>> len(rows.tobytes()), unpack_constellation(rows).centroids_m.tolist()
    (32, [(0.5+2j)])
    """
    place = rows["place"].astype(np.float32) * np.float32(1 / STEPS_PER_M)
    return PlacedBofs(
        rows["slice"].copy(),
        place[:, 0] + 1j * place[:, 1],
        _LOG_RADIUS[0] + rows["log_radius"].astype(np.float32) * _LOG_RADIUS[1],
        rows["mean"].astype(np.float32) * np.float32(1 / 255),
        np.exp(_LOG_LENGTH[0] + rows["log_length"].astype(np.float32) * _LOG_LENGTH[1]),
        rows["code"].astype(np.float32) * np.float32(1) / _CODE_SCALE,
    )
