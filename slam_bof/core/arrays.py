"""An array that grows row by row."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["GrowingArray", "thread_buffer"]


class GrowingArray:
    """Rows of one shape and type, in one block of memory that grows by an eighth.

    That wastes little and still copies seldom.

    >>> stack = GrowingArray((2,), np.int32)
    >>> stack.append([1, 2])
    >>> stack.append([3, 4])
    >>> stack.rows.tolist()
    [[1, 2], [3, 4]]
    """

    __slots__ = ("_block", "_n")

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._n = 0
        self._block: NDArray[Any] = np.empty((4, *shape), dtype)

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._n

    @property
    def rows(self) -> NDArray[Any]:
        """The rows so far, (n, *shape); a view, which rows that replace truncated ones change."""
        return self._block[: self._n]

    @property
    def nbytes(self) -> int:
        """Bytes of the block, with the room that it has to grow."""
        return self._block.nbytes

    def append(self, row: Any) -> None:
        """Add a row."""
        if self._n == len(self._block):
            room = np.empty((4 + self._n // 8, *self._block.shape[1:]), self._block.dtype)
            self._block = np.concatenate([self._block, room])
        self._block[self._n] = row
        self._n += 1

    def extend(self, rows: NDArray[Any]) -> None:
        """Add rows (m, *shape)."""
        n = self._n + len(rows)
        if n > len(self._block):
            room = np.empty((n + n // 8, *self._block.shape[1:]), self._block.dtype)
            room[: self._n] = self.rows
            self._block = room
        self._block[self._n : n] = rows
        self._n = n

    def truncate(self, n: int) -> None:
        """Drop all rows but the first ``n``."""
        self._n = min(n, self._n)


class _Arrays(threading.local):
    def __init__(self) -> None:
        self.by_name: dict[str, NDArray[np.uint8]] = {}


_arrays = _Arrays()


def thread_buffer(name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return an array of 8 bits, with whatever the last user of that name has left in it.

    It is the caller's until the same thread asks for the name again.
    """
    array = _arrays.by_name.get(name)
    if array is None or array.shape != shape:
        array = _arrays.by_name[name] = np.empty(shape, np.uint8)
    return array
