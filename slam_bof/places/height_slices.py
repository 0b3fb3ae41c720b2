"""The plan of what the camera sees, slice by slice of height, as a short spectrum.

Layers again, but level ones of a fixed height, and in metres: each says where in plan there is
something at that height. The correlation of two such plans over all shifts, for a few turns,
tells how alike two views are and how the camera moved between them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.places.phase_correlation import dft, shifts
from slam_bof.types import Array

__all__ = ["Slices"]

CELL_M = 0.1
N_CELLS = 40
PERIOD = 64
"""Cells and the empty ones after them, that a shift does not wrap around."""
CENTRE_M = 2.0
"""The plan's middle, so far ahead of the camera: about what it looks at, and turns about."""
HEIGHT_M = 0.2
N_HEIGHTS = 12
TOP_M = 1.0
"""The highest slice begins so far above the camera."""
HEIGHT_BLUR_M = 0.14
FREQUENCY = 6
"""The highest kept, both ways."""
YAWS_RAD = np.radians(np.arange(-60.0, 61.0, 20.0))
"""Turns that are tried."""
MAX_SHIFT = 16
SHIFT_STEP = 2
"""Shifts that are tried, in cells."""


class Slices:
    """Makes spectra of points and correlates them."""

    def __init__(self) -> None:
        k_x = np.arange(FREQUENCY + 1)
        k_z = np.arange(-FREQUENCY, FREQUENCY + 1)
        self._dft_x = dft(N_CELLS, PERIOD, k_x)
        self._dft_x[1:] *= np.sqrt(2.0)  # for the half of a real plan's spectrum left out
        self._dft_z = dft(N_CELLS, PERIOD, k_z)
        heights_m = np.arange(N_HEIGHTS) * HEIGHT_M
        blur = np.exp(-0.5 * ((heights_m[:, None] - heights_m) / HEIGHT_BLUR_M) ** 2)
        self._blur = (blur / blur.sum(axis=1, keepdims=True)).astype(np.float32)
        cells = np.arange(-MAX_SHIFT, MAX_SHIFT + 1, SHIFT_STEP)
        self._shifts_m = np.asarray(cells * CELL_M, np.float64)
        self._shift_x = shifts(cells, PERIOD, k_x)
        self._shift_z = shifts(cells, PERIOD, k_z)
        self.shape = (len(k_x), len(k_z), N_HEIGHTS)

    def spectra(
        self, points_level: NDArray[np.float32], yaws_rad: Array = YAWS_RAD
    ) -> NDArray[np.complex64]:
        """Return spectra (Y, *shape), each of length 1, of points (N, 3) in the levelled frame.

        Before each the points are turned by so much about an axis down at the plan's middle.
        Where nothing is in the plan it is zero.
        """
        x, y, z = points_level.T
        ahead = z - np.float32(CENTRE_M)
        height = np.floor((y + np.float32(TOP_M)) / np.float32(HEIGHT_M)).astype(np.intp)
        tall = (height >= 0) & (height < N_HEIGHTS)
        found = np.zeros((len(yaws_rad), *self.shape), np.complex64)
        for k, yaw in enumerate(yaws_rad):
            c, s = np.float32(np.cos(yaw)), np.float32(np.sin(yaw))
            column = (
                np.floor((c * x + s * ahead) / np.float32(CELL_M)).astype(np.intp) + N_CELLS // 2
            )
            row = np.floor((c * ahead - s * x) / np.float32(CELL_M)).astype(np.intp) + N_CELLS // 2
            inside = tall & (column >= 0) & (column < N_CELLS) & (row >= 0) & (row < N_CELLS)
            plan = np.zeros((N_HEIGHTS, N_CELLS, N_CELLS), np.float32)
            plan[height[inside], column[inside], row[inside]] = 1.0
            plan = (self._blur @ plan.reshape(N_HEIGHTS, -1)).reshape(plan.shape)
            spectrum = self._dft_x @ plan.astype(np.complex64) @ self._dft_z.T
            length = np.linalg.norm(spectrum)
            if length > 0:
                found[k] = np.moveaxis(spectrum / length, 0, -1)
        return found

    def compare(
        self, spectra: NDArray[np.complex64], turned: NDArray[np.complex64]
    ) -> tuple[NDArray[np.float32], Array]:
        """Compare spectra (n, *shape), unturned, with a query's (Y, *shape) at ``YAWS_RAD``.

        Returns
        -------
        scores : (n,) float32
            The highest correlation over all turns and shifts, at most 1.
        T_match_query : (n, 4, 4)
            The motion in the levelled frames where it is highest.
        """
        n, n_yaws, n_shifts = len(spectra), len(turned), len(self._shifts_m)
        product = spectra.transpose(1, 2, 0, 3) @ turned.transpose(1, 2, 3, 0).conj()
        product = product.reshape(*self.shape[:2], n * n_yaws)
        product = self._shift_z.conj() @ product
        parts = np.concatenate([product.real, product.imag]).reshape(2 * self.shape[0], -1)
        turns = np.concatenate([self._shift_x.real, self._shift_x.imag], axis=1) @ parts
        turns = turns.reshape(n_shifts**2, n, n_yaws)
        correlation = turns.transpose(1, 0, 2).reshape(n, n_shifts**2 * n_yaws)
        best = correlation.argmax(axis=1)
        scores = correlation[np.arange(n), best]
        shift_x, shift_z, yaw = np.unravel_index(best, (n_shifts, n_shifts, n_yaws))
        return scores, _motions(YAWS_RAD[yaw], self._shifts_m[shift_x], self._shifts_m[shift_z])


def _motions(yaws_rad: Array, shifts_x_m: Array, shifts_z_m: Array) -> Array:
    """Return ``T_match_query`` (n, 4, 4) of turns about the plan's middle and shifts."""
    c, s = np.cos(yaws_rad), np.sin(yaws_rad)
    T = np.zeros((len(yaws_rad), 4, 4))
    T[:, 0, 0], T[:, 0, 2], T[:, 2, 0], T[:, 2, 2] = c, s, -s, c
    T[:, 1, 1] = T[:, 3, 3] = 1.0
    T[:, 0, 3] = -s * CENTRE_M - shifts_x_m
    T[:, 2, 3] = CENTRE_M - c * CENTRE_M - shifts_z_m
    return T


def _cell(along: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the column or row of the plan, whose middle is at 0 metres."""
    return np.asarray(np.floor(along / np.float32(CELL_M)).astype(np.intp) + N_CELLS // 2)
