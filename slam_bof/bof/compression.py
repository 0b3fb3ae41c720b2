"""Lossy compression of BOF descriptors to a few bytes, for a map or a file.

The radii of a closed contour are periodic and smooth, so the low harmonics of their Fourier series
describe them well: each descriptor becomes ``2 n_harmonics`` bytes, whatever its length.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["pack", "unpack"]

FULL_SCALE = 0.5
"""Largest real or imaginary part that can be stored; radii in [0, 1] have none larger."""


def pack(descriptors: NDArray[np.float32], *, n_harmonics: int = 16) -> bytes:
    """Compress radii (C, n) to ``2 n_harmonics`` bytes each.

    The mean and the harmonics 1 to ``n_harmonics - 1`` are kept, each part rounded to 8 bits.

    Raises
    ------
    ValueError
        If the descriptors have fewer than ``2 n_harmonics`` values.
    """
    n_values = descriptors.shape[1]
    if n_values < 2 * n_harmonics:
        raise ValueError(f"descriptors must have at least {2 * n_harmonics} values, got {n_values}")
    spectrum = np.fft.rfft(descriptors - 0.5, axis=1)[:, :n_harmonics] / n_values
    parts = np.ascontiguousarray(spectrum, np.complex128).view(np.float64)
    return np.rint(parts * (127 / FULL_SCALE)).astype(np.int8).tobytes()


def unpack(data: bytes, *, n_values: int = 180, n_harmonics: int = 16) -> NDArray[np.float32]:
    """Return approximations of the descriptors (C, n_values) that ``pack`` was given.

    Raises
    ------
    ValueError
        If the number of bytes is no multiple of a descriptor's.

    Examples
    --------
    >>> angle = np.linspace(0, 2 * np.pi, 180, endpoint=False)
    >>> radii = np.float32(0.8 + 0.2 * np.cos(3 * angle))[None]
    >>> float(np.abs(unpack(pack(radii)) - radii).max()) < 0.005
    True
    """
    if len(data) % (2 * n_harmonics):
        raise ValueError(f"data must be of {2 * n_harmonics} bytes a descriptor, got {len(data)}")
    parts = np.frombuffer(data, np.int8).reshape(-1, 2 * n_harmonics) * (FULL_SCALE / 127)
    spectrum = np.zeros((len(parts), n_values // 2 + 1), np.complex128)
    spectrum[:, :n_harmonics] = parts.view(np.complex128) * n_values
    return (np.fft.irfft(spectrum, n=n_values, axis=1) + 0.5).astype(np.float32)
