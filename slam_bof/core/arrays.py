"""An array that grows row by row."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import DTypeLike, NDArray

__all__ = ["GrowingArray"]


class GrowingArray:
    """Rows of one shape and type in a block of memory that grows by one eighth when it is full.

    This wastes little memory and copies rarely.

    >>> stack = GrowingArray((2,), np.int32)
    >>> stack.append([1, 2])
    >>> stack.append([3, 4])
    >>> stack.rows.tolist()
    [[1, 2], [3, 4]]
    """

    __slots__ = ("_block", "_n", "_n_saved")

    def __init__(self, shape: tuple[int, ...], dtype: DTypeLike) -> None:
        self._n = 0
        self._n_saved = 0
        self._block: NDArray[Any] = np.empty((4, *shape), dtype)

    @classmethod
    def of(cls, rows: NDArray[Any]) -> Self:
        """Hold given rows, such as those of a file, which stay as they are."""
        growing = cls(rows.shape[1:], rows.dtype)
        growing._block, growing._n, growing._n_saved = rows, len(rows), len(rows)
        return growing

    def __len__(self) -> int:
        """Return the number of rows."""
        return self._n

    @property
    def rows(self) -> NDArray[Any]:
        """A view (n, *shape) of all rows. It changes when truncated rows are overwritten."""
        return self._block[: self._n]

    @property
    def nbytes(self) -> int:
        """Size of the block in bytes, spare rows included."""
        return self._block.nbytes

    def append(self, row: Any) -> None:
        """Add a row."""
        if self._n == len(self._block) or self._n < self._n_saved:
            self._move_to(4 + self._n + self._n // 8)
        self._block[self._n] = row
        self._n += 1

    def extend(self, rows: NDArray[Any]) -> None:
        """Add rows (m, *shape)."""
        n = self._n + len(rows)
        if n > len(self._block) or self._n < self._n_saved:
            self._move_to(n + n // 8)
        self._block[self._n : n] = rows
        self._n = n

    def truncate(self, n: int) -> None:
        """Keep only the first ``n`` rows."""
        self._n = min(n, self._n)

    def keep(self, is_kept: NDArray[np.bool_]) -> None:
        """Keep only the rows where ``is_kept`` (n,) is true, in their order."""
        self._block, self._n_saved = self.rows[is_kept], 0
        self._n = len(self._block)

    def put(self, index: Any, values: Any) -> None:
        """Replace rows by an index, as in ``rows[index] = values``."""
        if self._n_saved:
            self._move_to(len(self._block))
        self.rows[index] = values

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present rows; see ``core.Checkpoint``.

        They are not copied: a later row that would overwrite one of them moves to a new block.
        """
        block, n = self._block, self._n
        self._n_saved = n

        def restore() -> None:
            self._block, self._n, self._n_saved = block, n, n

        return restore

    def _move_to(self, n_rows: int) -> None:
        """Copy the rows into a new block with room for more."""
        block = np.empty((n_rows, *self._block.shape[1:]), self._block.dtype)
        block[: self._n] = self.rows
        self._block, self._n_saved = block, 0
