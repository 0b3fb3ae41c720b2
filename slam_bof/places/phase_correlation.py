"""Short spectra: the low frequencies of a grid, and its correlation with another over shifts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["dft", "shifts"]


def dft(n_cells: int, period: int, frequencies: NDArray[np.int_]) -> NDArray[np.complex64]:
    """Return the matrix (K, n_cells) that makes a blurred grid's spectrum at K frequencies.

    ``period`` is in cells, those that pad the grid included. The blur, a Gaussian of one cell,
    forgives what falls a little to the other side of a border.
    """
    phase = -2j * np.pi / period * np.outer(frequencies, np.arange(n_cells))
    blur = np.exp(-2.0 * (np.pi * frequencies / period) ** 2)
    return np.asarray(np.exp(phase) * blur[:, None], np.complex64)


def shifts(
    cells: NDArray[np.int_], period: int, frequencies: NDArray[np.int_]
) -> NDArray[np.complex64]:
    """Return what spectra are multiplied by to shift their grids by so many cells, (S, K).

    A grid ``g(x)`` becomes ``g(x + s)``.
    """
    return np.asarray(np.exp(2j * np.pi / period * np.outer(cells, frequencies)), np.complex64)
