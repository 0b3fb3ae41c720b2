"""A quick tour of the flat: turns at 120 degrees per second, and a lens that is covered twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from slam_bof.geometry import se3
from slam_bof.synthetic.flat import Flat, make_flat, make_tour
from slam_bof.synthetic.tour import FRAME_RATE_HZ
from slam_bof.synthetic.writer import Progress, write_scene
from slam_bof.types import Array

__all__ = ["BLACKOUT_S", "find_blackouts", "make_brisk_tour", "write_brisk_tour"]

BLACKOUT_S = 1.0
_TURN_RATE = float(np.deg2rad(120.0))
_GENERATION = 1


def make_brisk_tour(flat: Flat, *, seed: int = 0) -> Array:
    """Walk through the flat as ``make_tour`` does, turning at up to 120 degrees a second.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``.
    """
    return make_tour(flat, seed=seed, turn_rate=_TURN_RATE)


def find_blackouts(flat: Flat, poses: Array) -> NDArray[np.int64]:
    """Return the frames in which the lens is covered.

    The first time is the quickest turn in the kitchen. The second is the middle of the last stay in
    the hallway.

    Parameters
    ----------
    flat, poses
        ``T_world_camera`` (N, 4, 4) of a tour of this flat.

    Returns
    -------
    NDArray
        (M,) increasing frame numbers, which cover ``BLACKOUT_S`` twice.
    """
    kinds = np.array([flat.kind_at(x, y) for x, y in poses[:, :2, 3]])
    turned = se3.rotation_angle(se3.inverse(poses[:-1]) @ poses[1:])
    rate = gaussian_filter1d(np.append(turned, 0.0), BLACKOUT_S / 4 * FRAME_RATE_HZ)
    in_turn = int(np.where(kinds == "kitchen", rate, 0.0).argmax())
    between = np.flatnonzero(kinds == "corridor")
    stay = np.split(between, np.flatnonzero(np.diff(between) > 1) + 1)[-1]
    n = round(BLACKOUT_S * FRAME_RATE_HZ)
    starts = (in_turn - n // 2, int(stay[len(stay) // 2]) - n // 2)
    return np.concatenate([np.arange(start, start + n) for start in starts])


def write_brisk_tour(folder: Path, *, seed: int = 0, progress: Progress | None = None) -> Path:
    """Write ``folder/brisk/seq-01`` in 7-Scenes layout, unless it exists.

    Parameters
    ----------
    folder
        Parent of the scene folder ``brisk``, created if missing.
    seed
        Seed of flat, tour and sensor noise. The same seed gives the same bytes.
    progress
        Called after each frame.

    Returns
    -------
    Path
        The sequence's folder.

    Raises
    ------
    DatasetError
        If ``folder/brisk`` exists and was not written by this function.
    """
    flat = make_flat(seed)
    poses = make_brisk_tour(flat, seed=seed)
    return write_scene(
        folder / "brisk",
        "seq-01",
        flat.mesh,
        poses,
        recipe={"generation": _GENERATION, "kind": "brisk", "seed": seed},
        dark=frozenset(find_blackouts(flat, poses).tolist()),
        seed=seed,
        progress=progress,
    )
