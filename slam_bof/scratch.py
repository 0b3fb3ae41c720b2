"""Large arrays made once and used again, a set for each thread.

A fresh array of megabytes costs a page fault for every 4 kB of it when it is first written to,
which for the images of 20 layers takes longer than drawing them.
"""

from __future__ import annotations

import threading

import numpy as np
from numpy.typing import NDArray

__all__ = ["scratch_image"]


class _Arrays(threading.local):
    def __init__(self) -> None:
        self.by_name: dict[str, NDArray[np.uint8]] = {}


_arrays = _Arrays()


def scratch_image(name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
    """Return an array of 8 bits, with whatever the last user of that name has left in it.

    It is the caller's until the same thread asks for the name again.
    """
    array = _arrays.by_name.get(name)
    if array is None or array.shape != shape:
        array = _arrays.by_name[name] = np.empty(shape, np.uint8)
    return array
