"""Arrays in .npy format from anywhere: nothing is allocated before the header is believed."""

from __future__ import annotations

import io
import math
import tokenize
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

__all__ = ["parse_npy"]

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
    try:
        shape, is_fortran, dtype = HEADERS[npy.read_magic(stream)](stream)
    except (ValueError, TypeError, KeyError, SyntaxError, tokenize.TokenError, RecursionError):
        raise ValueError("found no header of a .npy file") from None
    if dtype.hasobject:
        raise ValueError("found Python objects, expected an array of numbers or text")
    found, n_items = len(data) - stream.tell(), math.prod(shape)
    if min(shape, default=0) < 0 or found != n_items * dtype.itemsize:
        raise ValueError(f"found {found} bytes, expected an array {shape} of {dtype}")
    array = np.frombuffer(data, dtype, n_items, stream.tell()) if found else np.empty(0, dtype)
    return array.reshape(shape, order="F" if is_fortran else "C").copy("K")
