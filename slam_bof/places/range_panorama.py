"""What is where around the camera, in directions and log range, as a short spectrum.

Points in the levelled frame mark cells of azimuth, elevation and logarithm of range. To turn the
camera shifts the cells in azimuth; to step towards what it sees shifts them in log range. The
correlation of two such images over all shifts, from their low frequencies alone, tells how alike
two views are, however they are turned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.places.phase_correlation import dft, shifts

__all__ = ["Panorama"]

CELL_RAD = np.radians(3.0)
N_AZIMUTHS, N_ELEVATIONS, N_RANGES = 48, 40, 40
TOP_RAD = np.radians(-45.0)
"""Elevations count down from here."""
NEAR_M, FAR_M = 0.4, 4.8
RANGE_PERIOD = 50
"""Ranges and the empty cells after them, that far does not wrap around to near."""
FREQUENCIES = (8, 6, 10)
"""The highest kept, in azimuth, elevation and log range."""
MAX_SHIFTS = (20, 2)
"""The largest tried, in cells of azimuth and of elevation."""
RANGE_SHIFTS = (-1, 0, 1)
RANGE_SHIFT_COST = 0.04
CHUNK = 128
"""Views scored at a time, that what is computed stays in the cache."""


class Panorama:
    """Makes spectra of points and correlates them."""

    def __init__(self) -> None:
        high_a, high_e, high_r = FREQUENCIES
        k_a = np.arange(-high_a, high_a + 1)
        k_e = np.arange(-high_e, high_e + 1)
        # The volume is real, so that half its spectrum tells all. Frequency 0 in range, how much
        # is seen in each direction, tells more of the sensor than of the place.
        k_r = np.arange(1, high_r + 1)
        elevations = TOP_RAD + (np.arange(N_ELEVATIONS) + 0.5) * CELL_RAD
        self._dft_a = dft(N_AZIMUTHS, N_AZIMUTHS, k_a)
        # Cells are narrower towards the poles.
        self._dft_e = dft(N_ELEVATIONS, N_ELEVATIONS, k_e) * np.cos(elevations).astype(np.float32)
        self._dft_r = dft(N_RANGES, RANGE_PERIOD, k_r)
        cells_a, cells_e = (np.arange(-most, most + 1) for most in MAX_SHIFTS)
        self._shift_a = shifts(cells_a, N_AZIMUTHS, k_a)
        self._shift_e = shifts(cells_e, N_ELEVATIONS, k_e)
        self._shift_r = shifts(np.array(RANGE_SHIFTS), RANGE_PERIOD, k_r)
        self._cost_r = (RANGE_SHIFT_COST * np.abs(RANGE_SHIFTS)).astype(np.float32)
        self.shape = (len(k_a), len(k_e), len(k_r))

    def spectrum(self, points_level: NDArray[np.float32]) -> NDArray[np.complex64]:
        """Return the spectrum, of ``shape`` and length 1, of points (N, 3) in the levelled frame.

        Where nothing is in range it is zero.
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
        """Return a spectrum in bytes, (*shape, 2), real and imaginary, and what a step is."""
        parts = spectrum[..., None].view(np.float32)
        step = np.float32(np.abs(parts).max() / 127)
        return np.rint(parts / (step if step > 0 else 1.0)).astype(np.int8), step

    def compare(
        self,
        packed: NDArray[np.int8],
        steps: NDArray[np.float32],
        query: NDArray[np.complex64],
    ) -> NDArray[np.float32]:
        """Return the highest correlation (n,) of packed spectra with a query's, at most 1."""
        scores = np.empty(len(packed), np.float32)
        ranges = np.conj(query[:, :, None] * self._shift_r)
        # Of the last product, over azimuth, only the real part is wanted.
        turn = np.concatenate([self._shift_a.real, self._shift_a.imag], axis=1)
        for start in range(0, len(packed), CHUNK):
            some = slice(start, start + CHUNK)
            # The views last: then all is contiguous along them.
            spectra = packed[some].astype(np.float32).view(np.complex64)[..., 0]
            product = ranges @ np.ascontiguousarray(spectra.transpose(1, 2, 3, 0))
            n_a, n_e, n_r, n = product.shape
            product = self._shift_e.conj() @ product.reshape(n_a, n_e, n_r * n)
            parts = np.concatenate([product.real, product.imag]).reshape(2 * n_a, -1)
            correlation = (turn @ parts).reshape(-1, n_r, n).max(axis=0)
            correlation *= steps[some]
            scores[some] = (correlation - self._cost_r[:, None]).max(axis=0)
        return scores
