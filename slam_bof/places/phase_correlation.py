"""Low-frequency Fourier spectra of grids, for their correlation over shifts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["dft", "shifts"]


def dft(n_cells: int, period: int, frequencies: NDArray[np.int_]) -> NDArray[np.complex64]:
    """Return the matrix (K, n_cells) of a Gaussian blur and a Fourier transform at K frequencies.

    ``period`` is the length of the grid in cells, padding included. The blur has a standard
    deviation of one cell and makes the spectrum robust to points near the border of a cell.
    """
    phase = -2j * np.pi / period * np.outer(frequencies, np.arange(n_cells))
    blur = np.exp(-2.0 * (np.pi * frequencies / period) ** 2)
    return np.asarray(np.exp(phase) * blur[:, None], np.complex64)


def shifts(
    cells: NDArray[np.int_], period: int, frequencies: NDArray[np.int_]
) -> NDArray[np.complex64]:
    """Return the factors (S, K) that shift the grids of spectra by each number of cells (S,).

    A grid ``g(x)`` becomes ``g(x + s)``.
    """
    return np.asarray(np.exp(2j * np.pi / period * np.outer(cells, frequencies)), np.complex64)
