"""The BOF constellation of a view: contours of level slices, described by BOF, with their places.

The paper compares unordered bags of BOFs, each divided by its largest radius (section 2). Here
each contour keeps, beside its BOF, where it is, how large it is and how it is turned. Two views
of one place then agree in many contours on one motion (``constellation_matching``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof.bof.levelled_slices import DEFAULT_SLICES, SliceParams, find_slice_contours
from slam_bof.bof.polygons import Polygons
from slam_bof.geometry import level_frame, view_points
from slam_bof.types import Array, DepthFrame, Params

__all__ = [
    "N_HARMONICS",
    "N_POINTS",
    "Constellation",
    "ConstellationParams",
    "PlacedBofs",
    "describe_constellation",
    "place_bofs",
]

N_POINTS = 180
"""Number of radii of a BOF, as in the paper."""
N_HARMONICS = 12
"""Number of terms of their spectrum that are kept: the mean and the lowest harmonics."""


class ConstellationParams(Params):
    """How contours are found, and which are kept."""

    slices: SliceParams = SliceParams()
    min_radius_m: float = Field(
        0.15,
        gt=0,
        description="Contours whose largest radius is smaller than this, in m, are dropped.",
    )
    max_contours: int = Field(
        40,
        gt=0,
        description="Largest number of contours of a view; the longest are kept.",
    )


class PlacedBofs(NamedTuple):
    """BOFs of C contours and where they are; a column each.

    Parameters
    ----------
    slices
        (C,) int8, the slice's number from the top.
    centroids_m
        (C,) complex64 ``x + i z`` in the levelled frame.
    log_radii
        (C,) float32, natural logarithm of the largest radius in metres.
    means
        (C,) float32, mean of the radii divided by the largest.
    lengths_m
        (C,) float32, of the contours.
    codes
        (C, 2 N_HARMONICS) float32: real, then imaginary parts of the radii's spectrum, scaled so
        that the product of two codes is the correlation of the radii by angle.
    """

    slices: NDArray[np.int8]
    centroids_m: NDArray[np.complex64]
    log_radii: NDArray[np.float32]
    means: NDArray[np.float32]
    lengths_m: NDArray[np.float32]
    codes: NDArray[np.float32]

    def take(self, rows: NDArray[Any] | slice) -> PlacedBofs:
        """Return some rows."""
        columns: tuple[NDArray[Any], ...] = self
        return PlacedBofs(*(column[rows] for column in columns))

    def radii(self, n: int = N_POINTS) -> Array:
        """Return the radii (C, n) by angle in metres, as far as the kept harmonics tell."""
        half = N_HARMONICS
        spectrum = np.zeros((len(self.slices), n // 2 + 1), np.complex128)
        spectrum[:, :half] = self.codes[:, :half] + 1j * self.codes[:, half:]
        spectrum[:, 1:] /= np.sqrt(2.0)
        radii = np.fft.irfft(spectrum, n=n, axis=1)
        scale = self.means * np.exp(self.log_radii) / np.maximum(radii.mean(axis=1), 1e-9)
        return np.asarray(radii * scale[:, None])


@dataclass(frozen=True, slots=True, eq=False)
class Constellation:
    """A view's BOFs, longest contour first, and how its camera is levelled.

    ``R_level_camera`` (3, 3) takes camera coordinates to the levelled frame: x right, y down
    (gravity), z ahead. ``slice_step_m`` is the height from one slice to the next.
    """

    bofs: PlacedBofs
    R_level_camera: Array
    slice_step_m: float = DEFAULT_SLICES.step_m

    def __len__(self) -> int:
        """Return the number of contours."""
        return len(self.bofs.slices)


def describe_constellation(
    frame: DepthFrame, gravity_camera: ArrayLike, params: ConstellationParams | None = None
) -> Constellation:
    """Describe a frame by the contours of its level slices.

    Parameters
    ----------
    frame
        The frame, of which the pixels that a map keeps are used (``geometry.view_points``).
    gravity_camera
        (3,), the direction down in the camera frame.

    Returns
    -------
    Constellation
        The constellation, empty if the frame has no depth.
    """
    p = params or ConstellationParams()
    R = level_frame(np.asarray(gravity_camera, np.float64))
    points_level = view_points(frame) @ R.T.astype(np.float32)
    return Constellation(place_bofs(points_level, p), R, p.slices.step_m)


def place_bofs(points_level: NDArray[np.float32], params: ConstellationParams) -> PlacedBofs:
    """Return the BOFs of points (N, 3) in the levelled frame, the longest contour first."""
    found = find_slice_contours(points_level, params.slices)
    polygons = Polygons(found.corners_m, found.counts)
    large = np.flatnonzero(polygons.largest_radii() >= params.min_radius_m)
    kept = large[np.argsort(-polygons.lengths[large], kind="stable")[: params.max_contours]]
    radii = polygons.radii(kept, N_POINTS)
    largest = np.maximum(radii.max(axis=1, initial=0.0), 1e-6)
    radii /= largest[:, None]
    return PlacedBofs(
        found.slices[kept].astype(np.int8),
        polygons.centroids[kept].astype(np.complex64),
        np.log(largest).astype(np.float32),
        radii.mean(axis=1).astype(np.float32),
        polygons.lengths[kept].astype(np.float32),
        encode(radii.astype(np.float32)),
    )


def encode(radii: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the codes (C, 2 N_HARMONICS) of radii (C, n).

    >>> one = np.random.default_rng(0).random((1, 180), np.float32)
    >>> smooth = np.fft.irfft(np.fft.rfft(one)[:, :8], n=180).astype(np.float32)
    >>> round(float(encode(smooth)[0] @ encode(smooth)[0]), 3)
    1.0
    """
    spectrum = radii @ _dft(radii.shape[1])
    norms = np.sqrt((radii * radii).sum(axis=1, keepdims=True) * np.float32(radii.shape[1]))
    return np.asarray(spectrum / np.maximum(norms, np.float32(1e-6)))


@lru_cache(maxsize=4)
def _dft(n: int) -> NDArray[np.float32]:
    """Return the matrix (n, 2 N_HARMONICS) that makes codes of radii."""
    phase = -2j * np.pi / n * np.outer(np.arange(n), np.arange(N_HARMONICS))
    rows = np.exp(phase)
    rows[:, 1:] *= np.sqrt(2.0)  # for the negative frequencies left out
    return np.concatenate([rows.real, rows.imag], axis=1).astype(np.float32)
