"""Disturbed playback of a sequence: cut, shuffled, darkened, or with drifting odometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.types import Array

__all__ = ["Play", "darkened", "drifted", "in_pieces", "uncut", "without"]

PAUSE_S = 1.0
"""Time in s between two pieces that did not follow each other."""


@dataclass(frozen=True, slots=True, eq=False)
class Play:
    """The order and the times of frames, and where tracking restarts.

    ``indices`` (N,) are frames of the sequence, and ``stamps_s`` (N,) their increasing times.
    ``restarts`` are the positions among the N frames at which odometry restarts. ``dark`` (N,) is
    true where the lens is covered.
    """

    indices: NDArray[np.int64]
    stamps_s: Array
    restarts: tuple[int, ...]
    dark: NDArray[np.bool_]

    def __len__(self) -> int:
        """Return the number of frames played."""
        return len(self.indices)


def uncut(stamps_s: Array) -> Play:
    """Play a sequence with the given times (N,) as it is."""
    n = len(stamps_s)
    return Play(np.arange(n), np.asarray(stamps_s, np.float64), (), np.zeros(n, dtype=bool))


def without(stamps_s: Array, first: int, last: int) -> Play:
    """Drop the frames from ``first`` to ``last``, both inclusive; tracking restarts after them.

    >>> play = without(np.arange(6) / 30, 2, 3)
    >>> play.indices.tolist(), play.restarts
    ([0, 1, 4, 5], (2,))

    Raises
    ------
    ValueError
        If no frame would remain before or after.
    """
    n = len(stamps_s)
    if not 0 < first <= last < n - 1:
        raise ValueError(f"frames {first} to {last} must be within 1 and {n - 2}")
    kept = np.concatenate([np.arange(first), np.arange(last + 1, n)])
    return Play(kept, np.asarray(stamps_s, np.float64)[kept], (first,), np.zeros(len(kept), bool))


def in_pieces(stamps_s: Array, order: Sequence[int]) -> Play:
    """Cut into pieces of equal length and play them in another order, one second apart.

    >>> play = in_pieces(np.arange(6) / 30, (2, 0, 1))
    >>> play.indices.tolist(), play.restarts
    ([4, 5, 0, 1, 2, 3], (2, 4))

    Raises
    ------
    ValueError
        If the order does not name each piece once, or there are fewer frames than pieces.
    """
    n = len(stamps_s)
    if sorted(order) != list(range(len(order))) or not 0 < len(order) <= n:
        raise ValueError(f"order must name each piece of {n} frames once, got {list(order)}")
    parts = np.array_split(np.arange(n), len(order))
    played = [parts[i] for i in order]
    stamps: list[Array] = []
    start_s = 0.0
    for part in played:
        stamps.append(stamps_s[part] - stamps_s[part[0]] + start_s)
        start_s = float(stamps[-1][-1]) + PAUSE_S
    restarts = np.cumsum([len(part) for part in played])[:-1]
    return Play(
        np.concatenate(played),
        np.concatenate(stamps),
        tuple(restarts.tolist()),
        np.zeros(n, dtype=bool),
    )


def darkened(play: Play, *, n_times: int = 2, lasting_s: float = 1.0) -> Play:
    """Cover the lens ``n_times``, evenly spread over the sequence.

    >>> darkened(uncut(np.arange(9.0)), lasting_s=1.5).dark.nonzero()[0].tolist()
    [3, 4, 6, 7]
    """
    starts = play.stamps_s[[len(play) * (i + 1) // (n_times + 1) for i in range(n_times)]]
    # Stamps are sums of thirtieths, so the end is compared with a tolerance.
    since = play.stamps_s[:, None] - starts + 1e-6
    return replace(play, dark=play.dark | ((since >= 0.0) & (since < lasting_s)).any(axis=1))


def drifted(
    poses: Array, *, scale: float = 0.02, rad_per_m: float = np.radians(1.0), axis: Array
) -> Array:
    """Return the poses of an odometry with a constant bias, given the true poses.

    Parameters
    ----------
    poses
        ``T_world_camera`` (N, 4, 4), all known.
    scale
        The share by which each step is too long.
    rad_per_m
        The angle by which the camera seems to turn for each metre that it moves.
    axis
        (3,) axis of the rotational bias, in the world frame.

    Returns
    -------
    Array
        ``T_odom_camera`` (N, 4, 4), identity for the first.
    """
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    moved_m = np.linalg.norm(steps[:, :3, 3], axis=1)
    axis_camera = poses[1:, :3, :3].swapaxes(1, 2) @ (axis / np.linalg.norm(axis))
    turn = np.zeros((len(steps), 6))
    turn[:, :3] = (rad_per_m * moved_m)[:, None] * axis_camera
    steps[:, :3, 3] *= 1.0 + scale
    steps = steps @ se3.exp(turn)
    out = np.empty_like(poses)
    out[0] = np.eye(4)
    for i, step in enumerate(steps):
        out[i + 1] = se3.nearest_pose(out[i] @ step)
    return out
