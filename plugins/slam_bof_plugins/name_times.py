"""Times that file names hold, as recorders write them, with their unit told by magnitude."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.types import Array

__all__ = ["as_seconds", "times_of_names"]

EPOCH_S = (1e9, 4.2e9)
"""Seconds since 1970 of the years 2001 to 2103."""
UNITS_PER_S = (1.0, 1e3, 1e6, 1e9)
NUMBER = re.compile(r"\d+(?:\.\d+)?")
DATE = re.compile(
    r"(\d{4})-?(\d\d)-?(\d\d)[-_T ](\d\d)[-_:.h]?(\d\d)[-_:.m]?(\d\d)(?:[-_.,](\d{1,9}))?(?!\d)"
)
REALSENSE = re.compile(r"(?:^|_)Depth_(\d+(?:\.\d+)?)$")
"""Names of realsense-viewer and rs-convert: milliseconds, since 1970 or the camera's start."""
PADDED_NS = re.compile(r"\d{19}")


def as_seconds(values: ArrayLike) -> Array:
    """Return times (N,) of a clock that counts s, ms, us or ns since 1970 in seconds.

    Times of another clock are returned as they are.

    >>> as_seconds([1617685268177380000, 1617685268210745344]).tolist()
    [1617685268.17738, 1617685268.2107453]
    >>> as_seconds([0.0, 0.5]).tolist()
    [0.0, 0.5]
    """
    found = np.asarray(values, dtype=np.float64)
    for units in UNITS_PER_S:
        if EPOCH_S[0] <= np.median(found) / units < EPOCH_S[1]:
            return np.asarray(found / units)
    return found


def times_of_names(names: Sequence[str], fps: float) -> Array:
    """Return the time (N,) in seconds of each image by its name, without suffix.

    In this order: a date and time, the milliseconds of RealSense tools, seconds and their fraction
    in two numbers, nanoseconds of 19 digits, a time since 1970 in whatever unit, seconds with a
    decimal point, and else the number of the image at ``fps``. Of several numbers in a name the
    last one counts that differs between the images.

    Examples
    --------
    >>> times_of_names(["d455_Depth_1617685268210.745", "d455_Depth_1617685268244.11"], 30)
    array([1.61768527e+09, 1.61768527e+09])
    >>> times_of_names(["depth9", "depth10"], 10).tolist()
    [0.9, 1.0]
    """
    for read in (_dates, _realsense, _seconds_and_fraction):
        stamps_s = read(names)
        if stamps_s is not None:
            return stamps_s
    words = _varying_numbers(names)
    if not words:
        return np.arange(len(names)) / fps
    last = words[-1]
    if all(PADDED_NS.fullmatch(word) for word in last):
        return np.array([int(word) * 1e-9 for word in last])
    values = np.array([float(word) for word in last])
    seconds = as_seconds(values)
    is_clock = EPOCH_S[0] <= np.median(seconds) < EPOCH_S[1] or any("." in word for word in last)
    return seconds if is_clock else values / fps


def _dates(names: Sequence[str]) -> Array | None:
    """Read dates and times, taken as UTC. One that all names share is that of the recording."""
    matches = [match for name in names if (match := DATE.search(name))]
    try:
        whole_s = [
            datetime(*(int(match[k]) for k in range(1, 7)), tzinfo=UTC).timestamp()  # type: ignore[arg-type,misc]
            for match in matches
        ]
    except ValueError:
        return None  # no such day
    fractions = [match[7] or "0" for match in matches]
    if len(matches) < len(names) or (len(names) > 1 and len({*whole_s}) == 1):
        return None
    return np.array(whole_s) + [int(word) * 10.0 ** -len(word) for word in fractions]


def _realsense(names: Sequence[str]) -> Array | None:
    words = [match[1] for name in names if (match := REALSENSE.search(name))]
    return np.array(words, np.float64) * 1e-3 if len(words) == len(names) else None


def _seconds_and_fraction(names: Sequence[str]) -> Array | None:
    """Read names that end with the seconds since 1970 and their ms, us or ns, as ROS counts."""
    pairs = [NUMBER.findall(name)[-2:] for name in names]
    if any(len(pair) < 2 or not all(map(str.isdecimal, pair)) for pair in pairs):
        return None
    seconds = np.array([float(pair[0]) for pair in pairs])
    digits = {len(pair[1]) for pair in pairs}
    if not (digits <= {3, 6, 9} and len(digits) == 1):
        return None
    if not ((EPOCH_S[0] <= seconds) & (seconds < EPOCH_S[1])).all():
        return None
    if digits != {9} and len({*seconds}) == 1 < len(names):
        return None  # the time of the recording, and the number of the image
    return seconds + np.array([int(pair[1]) for pair in pairs]) * 10.0 ** -digits.pop()


def _varying_numbers(names: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the numbers (N,) that differ between all names, or else all numbers, by their place.

    None if names differ in their count.
    """
    rows = [NUMBER.findall(name) for name in names]
    if len({*map(len, rows)}) != 1:
        return []
    columns = list(zip(*rows, strict=True))
    return [column for column in columns if len({*column}) == len(names)] or columns
