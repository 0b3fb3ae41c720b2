"""Trajectory files in the TUM and KITTI formats, and correction of trajectories by a map.

A TUM file has a line ``stamp tx ty tz qx qy qz qw`` for each pose. A KITTI file has a line for
each frame with the 12 numbers of the upper (3, 4) of ``T_world_camera``, row by row, and no time
stamps. Numbers are written in the shortest form that reads back as the same float64.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.types import Array, Trajectory

__all__ = [
    "delayed",
    "nearest_stamps",
    "read_kitti",
    "read_tum",
    "spread_correction",
    "warn_unknown",
    "write_kitti",
    "write_tum",
]

logger = logging.getLogger(__name__)

TOLERANCE = 1e-2
"""Largest deviation of the norm of a quaternion from 1. Files may have few digits, so quaternions
are normalised."""


MAX_GAP_S = 0.25
"""Poses farther apart than this are not interpolated."""


def delayed(trajectory: Trajectory, offset_s: float) -> Trajectory:
    """Return the poses at the same times, once ``offset_s`` is added to the time stamps of all.

    Poses are interpolated on the geodesic between the two next to that time. They are unknown (NaN)
    before the first and after the last one, and where the two are more than 0.25 s apart.

    Examples
    --------
    >>> moving = se3.exp(np.array([[0, 0, 0, x, 0, 0] for x in (0.0, 1.0, 2.0)]))
    >>> late = delayed(Trajectory(np.array([0.0, 0.1, 0.2]), moving), 0.025)
    >>> late.poses[:, 0, 3].round(2).tolist()
    [nan, 0.75, 1.75]
    """
    stamps_s, poses = trajectory.stamps_s, trajectory.poses
    if offset_s == 0.0 or len(stamps_s) == 0:
        return trajectory
    asked_s = stamps_s - offset_s
    after = np.clip(np.searchsorted(stamps_s, asked_s), 1, max(len(stamps_s) - 1, 1))
    made = np.full_like(poses, np.nan)
    if len(stamps_s) > 1:
        gaps_s = stamps_s[after] - stamps_s[after - 1]
        fraction = (asked_s - stamps_s[after - 1]) / gaps_s
        known = (fraction >= 0.0) & (fraction <= 1.0) & (gaps_s <= MAX_GAP_S)
        known &= np.isfinite(poses[after]).all(axis=(1, 2))
        known &= np.isfinite(poses[after - 1]).all(axis=(1, 2))
        ends = after[known]
        made[known] = se3.interpolate(poses[ends - 1], poses[ends], fraction[known, None])
    return Trajectory(stamps_s, made)


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory in TUM format; unknown poses (NaN) are left out."""
    known = np.isfinite(trajectory.poses).all(axis=(1, 2))
    poses = trajectory.poses[known]
    columns = [trajectory.stamps_s[known, None], poses[:, :3, 3], _quaternions(poses)]
    _write(path, np.hstack(columns))


def read_tum(path: Path) -> Trajectory:
    """Read a trajectory in TUM format; empty lines and ``#`` comments are skipped.

    Recorders write NaN, infinity or a zero quaternion where they know no pose. Such a pose is
    unknown (NaN), and a line whose stamp is not after the one before is left out, both with a
    warning.

    Raises
    ------
    DatasetError
        If the file cannot be read, a line does not consist of 8 numbers, or no line is a pose.
    """
    rows: list[Array] = []
    problems: list[str] = []
    for where, row in _rows(path, 8, "stamp tx ty tz qx qy qz qw"):
        norm = np.linalg.norm(row[4:])
        if not np.isfinite(row).all():
            problems.append(f"{where}: found NaN or infinity, expected 8 finite numbers")
        elif abs(norm - 1.0) > TOLERANCE:
            problems.append(f"{where}: found a quaternion of norm {norm:.6g}, expected 1")
        elif np.abs(row[1:4]).max() > se3.MAX_POSITION_M:
            problems.append(f"{where}: found a position at {row[1:4]} m, expected metres")
            row[1:4] = np.nan
        elif rows and row[0] <= rows[-1][0]:
            problems.append(
                f"{where}: found stamp {float(row[0])} s after {float(rows[-1][0])} s, "
                "expected increasing stamps"
            )
            continue
        if np.isfinite(row[0]) and not (rows and row[0] <= rows[-1][0]):
            rows.append(row)
    table = np.array(rows).reshape(-1, 8)
    norms = np.linalg.norm(table[:, 4:], axis=1)
    known = np.isfinite(table).all(axis=1) & (np.abs(norms - 1.0) <= TOLERANCE)
    if problems and not known.any():
        raise DatasetError(problems[0])
    warn_unknown(path, problems, len(rows))
    poses = np.full((len(table), 4, 4), np.nan)
    if known.any():
        poses[known] = se3.from_quaternion(table[known, 4:], table[known, 1:4])
    return Trajectory(table[:, 0], poses)


def warn_unknown(path: Path, problems: Sequence[str], n_poses: int) -> None:
    """Warn in one line, with the first problem, that poses of a file are unknown."""
    if problems:
        logger.warning(
            "%s: %d of %d poses are unknown or left out; the first: %s",
            path,
            len(problems),
            max(n_poses, len(problems)),
            problems[0],
        )


def write_kitti(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory in KITTI format; an unknown pose is a line of 12 ``nan``.

    Unknown poses cannot be left out, because the number of a line is that of its frame.
    """
    _write(path, trajectory.poses[:, :3].reshape(-1, 12))


def read_kitti(path: Path, stamps_s: Array | None = None) -> Trajectory:
    """Read a trajectory in KITTI format.

    Parameters
    ----------
    path
        The file to read.
    stamps_s
        (N,) times of the poses in seconds. By default they are the numbers of the lines from 0.

    Raises
    ------
    DatasetError
        If the file cannot be read, a line is neither a rigid transform nor 12 ``nan``, or the
        numbers of poses and time stamps differ.
    """
    rows: list[Array] = []
    for where, row in _rows(path, 12, "the first 3 rows of a pose"):
        if not np.isnan(row).all():
            _check_pose(row.reshape(3, 4), where)
        rows.append(row)
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3] = np.array(rows).reshape(-1, 3, 4)
    poses[np.isnan(poses).any(axis=(1, 2))] = np.nan
    if stamps_s is None:
        stamps_s = np.arange(len(poses), dtype=np.float64)
    if len(stamps_s) != len(poses):
        raise DatasetError(f"{path}: found {len(poses)} poses, expected {len(stamps_s)}")
    return Trajectory(np.asarray(stamps_s, dtype=np.float64), poses)


def nearest_stamps(stamps_s: Array, among_s: Array) -> NDArray[np.intp]:
    """Return the index of the nearest of the sorted ``among_s``; the earlier one in a tie.

    >>> nearest_stamps(np.array([-1.0, 0.5, 1.6]), np.array([0.0, 1.0, 2.0])).tolist()
    [0, 0, 2]
    """
    after = np.searchsorted(among_s, stamps_s).clip(0, len(among_s) - 1)
    before = np.maximum(after - 1, 0)
    is_earlier = np.abs(stamps_s - among_s[before]) <= np.abs(among_s[after] - stamps_s)
    return np.asarray(np.where(is_earlier, before, after), dtype=np.intp)


def spread_correction(
    T_odom_camera: Array,
    stamps_s: Array,
    keyframe_indices: Array,
    T_map_keyframes: Array,
    segments: Array | None = None,
) -> Array:
    """Apply the corrections of keyframes to all frames, interpolating in between.

    The pose of each frame is predicted by odometry from the keyframe before it and from the one
    after it, and the two predictions are interpolated by time. Interpolating poses, not
    corrections, avoids a lever arm: a frame moves no farther than its keyframes. If odometry was
    lost between the two keyframes, a frame follows the keyframe of its own segment; a frame that
    was taken while odometry was lost is interpolated between both.

    Parameters
    ----------
    T_odom_camera, stamps_s
        (N, 4, 4) odometry poses and (N,) times of all frames.
    keyframe_indices, T_map_keyframes
        (K,) increasing frame indices and (K, 4, 4) optimised poses of the keyframes, K > 0.
    segments
        (N,) the segment (uninterrupted track) of each frame, -1 while odometry was lost. By
        default all frames belong to one segment.

    Returns
    -------
    Array
        (N, 4, 4) T_map_camera.
    """
    frames = np.arange(len(T_odom_camera))
    before = np.maximum(np.searchsorted(keyframe_indices, frames, side="right") - 1, 0)
    after = np.minimum(before + 1, len(keyframe_indices) - 1)
    T_map_odom = T_map_keyframes @ se3.inverse(T_odom_camera[keyframe_indices])
    start_s, end_s = stamps_s[keyframe_indices][before], stamps_s[keyframe_indices][after]
    span_s = np.where(after > before, end_s - start_s, 1.0)
    fraction = np.where(after > before, np.maximum(stamps_s - start_s, 0.0) / span_s, 0.0)
    if segments is not None:
        keyframe_segments = segments[keyframe_indices]
        was_lost = keyframe_segments[before] != keyframe_segments[after]
        fraction[was_lost & (segments == keyframe_segments[before])] = 0.0
        fraction[was_lost & (segments == keyframe_segments[after])] = 1.0
    return se3.interpolate(
        T_map_odom[before] @ T_odom_camera, T_map_odom[after] @ T_odom_camera, fraction[:, None]
    )


def _quaternions(poses: Array) -> Array:
    """Return (N, 4) quaternions. SciPy does not accept an empty stack of matrices."""
    return se3.to_quaternion(poses) if len(poses) else np.empty((0, 4))


def _check_pose(T: Array, where: str) -> None:
    try:
        se3.check_rigid(T)
    except ValueError as error:
        raise DatasetError(f"{where}: {error}") from None


def _write(path: Path, table: Array) -> None:
    lines = (" ".join(map(repr, row)) + "\n" for row in table.tolist())
    with Path(path).open("w", encoding="ascii", newline="\n") as file:
        file.writelines(lines)


def _rows(path: Path, n_numbers: int, meaning: str) -> Iterator[tuple[str, Array]]:
    """Yield the location of each line, for error messages, and its numbers."""
    for number, line in enumerate(_lines(path), start=1):
        fields = line.split()
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{path}, line {number}"
        try:
            # Old C libraries write NaN and infinity as -1.#IND and 1.#INF.
            row = np.array([np.nan if ".#" in field else float(field) for field in fields])
        except ValueError:
            raise DatasetError(
                f"{where}: found {line.strip()[:60]!r}, expected {n_numbers} numbers: {meaning}"
            ) from None
        if len(row) != n_numbers:
            raise DatasetError(
                f"{where}: found {len(row)} numbers, expected {n_numbers}: {meaning}"
            )
        yield where, row


def _lines(path: Path) -> Iterable[str]:
    try:
        return read_text(Path(path)).splitlines()
    except UnicodeDecodeError:
        raise DatasetError(f"{path}: found binary data, expected a text file of poses") from None
    except OSError as error:
        reason = error.strerror or str(error)
        raise DatasetError(f"{path}: cannot be read ({reason}), expected poses") from None
