"""The times of a bag's images: by their headers, where a few stamps may be broken."""

from __future__ import annotations

import bisect

import numpy as np
from numpy.typing import NDArray

__all__ = ["order_by_stamp"]

MAX_DELAY_CHANGE_NS = 10**9
"""Largest deviation from the usual delay between stamp and reception of an image in order."""
MAX_BROKEN = 0.1
"""Largest share of images with a broken stamp among which the others are trusted."""
MIN_DISTANCE = 0.75
"""Least distance to the nearest trusted stamp, in frame periods, of an image that fills a gap."""

Times = NDArray[np.int64]


def order_by_stamp(stamped: Times, received: Times) -> NDArray[np.intp] | None:
    """Return the images in the order of their header stamps, without those of a broken stamp.

    Stamp and reception of most images differ by about the same delay. Where they do not, one of
    the two is broken. It is the reception if the stamp fills a gap between those of others; then
    the image keeps its place. Otherwise it is left out, and so is an image whose stamp repeats
    another.

    Parameters
    ----------
    stamped, received
        (N,) times in ns by the headers and by the recorder.

    Returns
    -------
    NDArray or None
        Indices of the images with increasing stamps; None if too many stamps are broken.

    Examples
    --------
    >>> received = np.arange(20) * 100 + 7
    >>> stamped = np.arange(20) * 100
    >>> stamped[[4, 5, 6]] = 10**15, 400, 400  # the future, the past, and again
    >>> order_by_stamp(stamped, received)[:6].tolist()
    [0, 1, 2, 3, 5, 7]
    """
    delays = received - stamped
    usual = np.abs(delays - np.median(delays)) <= MAX_DELAY_CHANGE_NS
    max_broken = max(1, int(MAX_BROKEN * len(stamped)))
    if np.count_nonzero(~usual) > max_broken:
        # The delay changes all the time: the recorder's clock is another, or broken itself.
        order = _longest_increasing(stamped)
    else:
        trusted = np.unique(stamped[usual])
        gaps = np.flatnonzero(~usual)
        order = np.concatenate([np.flatnonzero(usual), gaps[_fills_gap(stamped[gaps], trusted)]])
        order = order[np.argsort(stamped[order], kind="stable")]
        order = order[np.diff(stamped[order], prepend=stamped[order[0]] - 1) > 0]
    return order if len(order) >= len(stamped) - max_broken else None


def _fills_gap(stamps: Times, trusted: Times) -> NDArray[np.bool_]:
    """Return which stamps lie within the trusted ones, but at none of their places."""
    if len(trusted) < 2:
        return np.zeros(len(stamps), bool)
    period = float(np.median(np.diff(trusted)))
    after = np.clip(np.searchsorted(trusted, stamps), 1, len(trusted) - 1)
    distances = np.minimum(np.abs(trusted[after] - stamps), np.abs(trusted[after - 1] - stamps))
    low, high = trusted[0] - MAX_DELAY_CHANGE_NS, trusted[-1] + MAX_DELAY_CHANGE_NS
    within = (low <= stamps) & (stamps <= high)
    return np.asarray(within & (distances >= MIN_DISTANCE * period))


def _longest_increasing(values: Times) -> NDArray[np.intp]:
    """Return the indices of the longest increasing subsequence."""
    tails: list[int] = []
    ends: list[int] = []
    before = np.full(len(values), -1)
    for i, value in enumerate(values.tolist()):
        at = bisect.bisect_left(tails, value)
        tails[at : at + 1] = [value]
        ends[at : at + 1] = [i]
        before[i] = ends[at - 1] if at else -1
    found, i = [], ends[-1] if ends else -1
    while i >= 0:
        found.append(i)
        i = int(before[i])
    return np.array(found[::-1], np.intp)
