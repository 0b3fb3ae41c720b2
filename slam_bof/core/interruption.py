"""Ctrl-C, also where C code was at work when it came."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["unwrap_interruption"]


@contextmanager
def unwrap_interruption() -> Iterator[None]:
    """Raise ``KeyboardInterrupt`` for a ``SystemError`` that was caused by one.

    Ctrl-C that comes while C code is at work, such as Numba's when it calls a compiled function,
    ends in a ``SystemError`` ("returned a result with an exception set").
    """
    try:
        yield
    except SystemError as error:
        cause: BaseException | None = error
        while cause is not None and not isinstance(cause, KeyboardInterrupt):
            cause = cause.__cause__
        if cause is None:
            raise
        raise KeyboardInterrupt from error
