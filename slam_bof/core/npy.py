"""Arrays in .npy format of unknown origin: the header is checked before memory is reserved."""

from __future__ import annotations

import io
import math
import tokenize
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from slam_bof.core.files import open_bytes

__all__ = ["open_npy", "parse_npy"]

HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}


def parse_npy(data: bytes) -> NDArray[Any]:
    """Return the array in the bytes of a .npy file.

    >>> parse_npy(b"no array")
    Traceback (most recent call last):
    ValueError: found no header of a .npy file

    Raises
    ------
    ValueError
        If it is none, holds Python objects, or has another number of bytes than its shape says.
    """
    stream = io.BytesIO(data)
    shape, order, dtype = _read_header(stream, len(data))
    array = np.frombuffer(data, dtype, math.prod(shape), stream.tell() if math.prod(shape) else 0)
    return array.reshape(shape, order=order).copy("K")


def open_npy(path: Path) -> NDArray[Any]:
    """Map the array of a .npy file into memory: only its header is read.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        As ``parse_npy``.
    """
    with open_bytes(path) as file:
        shape, order, dtype = _read_header(file, path.stat().st_size)
        if not math.prod(shape):
            return np.empty(shape, dtype)
        return np.memmap(file, dtype, "r", file.tell(), shape, order)


def _read_header(stream: BinaryIO, n_bytes: int) -> tuple[tuple[int, ...], Any, np.dtype[Any]]:
    """Return shape, order and type of the array that follows in a stream of ``n_bytes``."""
    try:
        shape, is_fortran, dtype = HEADERS[npy.read_magic(stream)](stream)
    except (ValueError, TypeError, KeyError, SyntaxError, tokenize.TokenError, RecursionError):
        raise ValueError("found no header of a .npy file") from None
    if dtype.hasobject:
        raise ValueError("found Python objects, expected an array of numbers or text")
    found = n_bytes - stream.tell()
    if min(shape, default=0) < 0 or found != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"found {found} bytes, expected an array {shape} of {dtype}")
    return shape, "F" if is_fortran else "C", dtype
