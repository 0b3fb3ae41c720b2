"""Range panorama: the Fourier spectrum of the occupancy in azimuth, elevation and log range.

Points in the levelled frame occupy cells of a grid over azimuth, elevation and logarithm of range.
A rotation of the camera about the vertical shifts the grid in azimuth, and a step towards the
surfaces shifts it in log range. The largest correlation of two grids over these shifts, computed
from their low frequencies, measures the similarity of two views independently of their heading.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.places.phase_correlation import dft, shifts

__all__ = ["Panorama"]

CELL_RAD = np.radians(3.0)
N_AZIMUTHS, N_ELEVATIONS, N_RANGES = 48, 40, 40
TOP_RAD = np.radians(-45.0)
"""Elevation of the top of the grid; elevations increase downwards."""
NEAR_M, FAR_M = 0.4, 4.8
"""Limits of the grid in range."""
RANGE_PERIOD = 50
"""Number of range cells with padding, so that shifts do not wrap from far to near."""
FREQUENCIES = (8, 6, 10)
"""Highest frequencies that are kept, in azimuth, elevation and log range."""
MAX_SHIFTS = (20, 2)
"""Largest shifts that are tried, in cells of azimuth and of elevation."""
RANGE_SHIFTS = (-1, 0, 1)
RANGE_SHIFT_COST = 0.04
"""Reduction of the score per cell of shift in log range."""
CHUNK = 128
"""Number of views scored at a time, so that intermediate results fit into the CPU cache."""


class Panorama:
    """Computes spectra of points and their correlations."""

    def __init__(self) -> None:
        high_a, high_e, high_r = FREQUENCIES
        k_a = np.arange(-high_a, high_a + 1)
        k_e = np.arange(-high_e, high_e + 1)
        # The grid is real, so half of its spectrum suffices. Frequency 0 in range is the number of
        # occupied cells in each direction, which depends more on the sensor than on the place.
        k_r = np.arange(1, high_r + 1)
        elevations = TOP_RAD + (np.arange(N_ELEVATIONS) + 0.5) * CELL_RAD
        self._dft_a = dft(N_AZIMUTHS, N_AZIMUTHS, k_a)
        # Cells are narrower towards the poles, so they get a smaller weight.
        self._dft_e = dft(N_ELEVATIONS, N_ELEVATIONS, k_e) * np.cos(elevations).astype(np.float32)
        self._dft_r = dft(N_RANGES, RANGE_PERIOD, k_r)
        cells_a, cells_e = (np.arange(-most, most + 1) for most in MAX_SHIFTS)
        self._shift_a = shifts(cells_a, N_AZIMUTHS, k_a)
        self._shift_e = shifts(cells_e, N_ELEVATIONS, k_e)
        self._shift_r = shifts(np.array(RANGE_SHIFTS), RANGE_PERIOD, k_r)
        self._cost_r = (RANGE_SHIFT_COST * np.abs(RANGE_SHIFTS)).astype(np.float32)
        self.shape = (len(k_a), len(k_e), len(k_r))

    def spectrum(self, points_level: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Return the spectrum of points (N, 3) in the levelled frame, an array of ``shape``.

        It has norm 1, or is zero if no point is in range.
        """
        x, y, z = points_level.T
        across2 = x * x + z * z
        ranges = np.sqrt(across2 + y * y)
        azimuth = np.floor(np.arctan2(x, z) / np.float32(CELL_RAD)).astype(np.intp) % N_AZIMUTHS
        elevation = (np.arctan2(y, np.sqrt(across2)) - np.float32(TOP_RAD)) / np.float32(CELL_RAD)
        elevation = np.floor(elevation).astype(np.intp)
        cells_per_fold = np.float32(N_RANGES / np.log(FAR_M / NEAR_M))
        log_range = np.floor(np.log(ranges / np.float32(NEAR_M)) * cells_per_fold).astype(np.intp)
        inside = (
            (elevation >= 0)
            & (elevation < N_ELEVATIONS)
            & (log_range >= 0)
            & (log_range < N_RANGES)
        )
        cells = np.zeros((N_AZIMUTHS, N_ELEVATIONS, N_RANGES), np.float32)
        cells[azimuth[inside], elevation[inside], log_range[inside]] = 1.0
        spectrum = cells.reshape(-1, N_RANGES) @ self._dft_r.T
        spectrum = self._dft_e @ spectrum.reshape(N_AZIMUTHS, N_ELEVATIONS, -1)
        spectrum = self._dft_a @ spectrum.reshape(N_AZIMUTHS, -1)
        length = np.linalg.norm(spectrum)
        return np.asarray(spectrum / (length if length > 0 else 1.0)).reshape(self.shape)

    @staticmethod
    def pack(spectrum: NDArray[np.complex64]) -> tuple[NDArray[np.int8], np.float32]:
        """Quantise a spectrum to int8 (*shape, 2), real and imaginary; return it and its step."""
        parts = spectrum[..., None].view(np.float32)
        step = np.float32(np.abs(parts).max() / 127)
        return np.rint(parts / (step if step > 0 else 1.0)).astype(np.int8), step

    def compare(
        self,
        packed: NDArray[np.int8],
        steps: NDArray[np.float32],
        query: NDArray[np.complex64],
    ) -> NDArray[np.float32]:
        """Return the largest correlation (n,), at most 1, of packed spectra with a query."""
        scores = np.empty(len(packed), np.float32)
        ranges = np.conj(query[:, :, None] * self._shift_r)
        # Only the real part of the last product, over azimuth, is needed.
        turn = np.concatenate([self._shift_a.real, self._shift_a.imag], axis=1)
        for start in range(0, len(packed), CHUNK):
            chunk = slice(start, start + CHUNK)
            # With the views as the last axis, memory is contiguous along them.
            spectra = packed[chunk].astype(np.float32).view(np.complex64)[..., 0]
            product = ranges @ np.ascontiguousarray(spectra.transpose(1, 2, 3, 0))
            n_a, n_e, n_r, n = product.shape
            product = self._shift_e.conj() @ product.reshape(n_a, n_e, n_r * n)
            parts = np.concatenate([product.real, product.imag]).reshape(2 * n_a, -1)
            correlation = (turn @ parts).reshape(-1, n_r, n).max(axis=0)
            correlation *= steps[chunk]
            scores[chunk] = (correlation - self._cost_r[:, None]).max(axis=0)
        return scores
