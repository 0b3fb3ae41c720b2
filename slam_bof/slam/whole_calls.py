"""Calls that happen one at a time, and each whole or not at all."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from slam_bof.core import Checkpoint

__all__ = ["WholeCalls"]


class WholeCalls:
    """Keeps calls of several threads apart, and takes back what a failed call has changed.

    >>> calls, values = WholeCalls(), [1]
    >>> before = Checkpoint()
    >>> before.save(values)
    >>> with calls.alone(), calls.whole(before):
    ...     values.append(2)
    ...     raise ValueError("failed half-way")
    Traceback (most recent call last):
    ValueError: failed half-way
    >>> values
    [1]
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._owner: int | None = None
        self._before: Checkpoint | None = None

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Wait until calls of other threads have ended; what follows runs alone.

        Raises
        ------
        RuntimeError
            If it is called from inside another call, which would wait forever.
        """
        if self._lock.locked() and self._owner == threading.get_ident():
            raise RuntimeError("called from inside another call of the same loop closer")
        with self._lock:
            try:
                self._owner = threading.get_ident()
                self._take_back()  # if an interruption kept the call before from doing so
                yield
            except BaseException:
                self._take_back()
                raise
            finally:
                self._owner = None

    @property
    def current(self) -> Checkpoint | None:
        """The state before the call that this thread is in, None where it is in none."""
        return self._before if self._owner == threading.get_ident() else None

    @contextmanager
    def whole(self, before: Checkpoint) -> Iterator[Checkpoint]:
        """Return to the state ``before`` if what follows fails, even by Ctrl-C; within ``alone``.

        More may be saved in the checkpoint before it is changed.
        """
        self._before = before
        yield before
        self._before = None

    def _take_back(self) -> None:
        if self._before is not None:
            self._before.restore()
            self._before = None
