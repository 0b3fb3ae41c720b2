"""Choice of the best of many keyframes, none close in time to a better one."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["spread_maxima"]


def spread_maxima(
    ids: NDArray[np.integer[Any]],
    scores: NDArray[np.floating[Any]],
    *,
    max_n: int,
    separation: int,
) -> list[int]:
    """Return up to ``max_n`` ids with the highest scores above 0, best first.

    Parameters
    ----------
    ids, scores
        (n,) each, of the keyframes to choose from, in order of time.
    max_n
        Largest number of ids.
    separation
        Smallest difference between two ids.

    Examples
    --------
    >>> spread_maxima(np.arange(5), np.array([0.6, 0.1, 0.9, 0.8, 0.0]), max_n=3, separation=2)
    [2, 0]
    """
    left = np.array(scores, np.float64)
    chosen: list[int] = []
    while len(chosen) < max_n and len(left) and left.max() > 0.0:
        best = int(ids[left.argmax()])
        chosen.append(best)
        left[np.abs(ids - best) < separation] = 0.0
    return chosen
