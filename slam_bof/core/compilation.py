"""Compilation of numerical loops."""

from __future__ import annotations

from collections.abc import Callable
from typing import ParamSpec, TypeVar, cast

import numba

__all__ = ["compiled", "find_kept"]

P = ParamSpec("P")
R = TypeVar("R")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function of arrays and numbers to machine code, when it is first called.

    The code is kept on disk for later processes where there is a place that can be written: beside
    the source, or in the user's cache folder. Other threads run meanwhile. Arithmetic is that of
    IEEE 754 in the order in which it is written, so that results repeat; a division by zero gives
    infinity.
    """
    try:
        found = numba.njit(function, cache=True, nogil=True, error_model="numpy")
    except RuntimeError:  # no place to keep it
        found = numba.njit(function, nogil=True, error_model="numpy")
    return cast(Callable[P, R], found)


def find_kept(function: Callable[..., object]) -> str:
    """Return the folder in which the code of a compiled function is kept, empty if in none."""
    stats = getattr(function, "stats", None)  # none where NUMBA_DISABLE_JIT is set
    return str(getattr(stats, "cache_path", None) or "")
