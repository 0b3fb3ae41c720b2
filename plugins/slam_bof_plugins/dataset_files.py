"""What data sets share: how files become depth, colour, times and poses of frames."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.core import decode_image, read_bytes, read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import nearest_stamps, ray_slopes, read_tum, se3
from slam_bof.types import INVALID_DEPTH_MM, Array, Intrinsics, Trajectory
from slam_bof_plugins.depth_png import check_header, read_depth_png

__all__ = [
    "check_depth_files",
    "check_stamps",
    "nearest",
    "poses_at",
    "read_gray",
    "read_groundtruth",
    "read_lines",
    "read_rgb",
    "register",
    "scale_depth",
    "sequence_name",
]

logger = logging.getLogger(__name__)

MILLIMETRES_PER_M = 1000.0
MAX_GAP_S = 0.1
"""Largest time between two true poses that a frame between them is given a pose by."""


def sequence_name(path: Path) -> str:
    """Return the last two parts of a path: scene and sequence."""
    return "/".join(path.resolve().parts[-2:])


def scale_depth(raw: NDArray[np.uint16], units_per_m: float) -> NDArray[Any]:
    """Return a depth image as ``DepthFrame`` takes it.

    Parameters
    ----------
    raw
        (H, W) uint16 in units of the file, 0 and 65535 (saturated) where missing.
    units_per_m
        How many of them are a metre: 5000 for TUM, 6553.5 for Replica.

    Returns
    -------
    NDArray
        ``raw`` itself where its units are millimetres; else (H, W) float32 metres, each the
        float32 nearest to the exact quotient, so that nothing is rounded to whole millimetres.

    Examples
    --------
    >>> scale_depth(np.array([[0, 5000, 65535]], np.uint16), 5000.0)
    array([[0., 1., 0.]], dtype=float32)
    """
    if units_per_m == MILLIMETRES_PER_M:
        return raw
    metres = (raw / units_per_m).astype(np.float32)
    metres[raw == INVALID_DEPTH_MM] = 0.0
    return metres


def check_depth_files(files: Sequence[Path]) -> tuple[int, int]:
    """Read the first depth image and the headers of the others; return (height, width).

    Raises
    ------
    DatasetError
        If the first cannot be read, or one says that it is of 8 bits, in colour or of another
        size. Other damage shows when the frame is read.
    """
    height, width = read_depth_png(files[0]).shape
    for file in files[1:]:
        check_header(file, (height, width))
    return height, width


def read_rgb(path: Path | None) -> NDArray[np.uint8] | None:
    """Read an image as (H, W, 3) RGB; None without a file, or with a warning if unreadable."""
    bgr = _read_image(path, cv2.IMREAD_COLOR)
    if bgr is None:
        return None
    return np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def read_gray(path: Path | None) -> NDArray[np.uint8] | None:
    """Read an image in grey, (H, W); None as in ``read_rgb``."""
    return _read_image(path, cv2.IMREAD_GRAYSCALE)


def register(
    rgb: NDArray[np.uint8], camera: Intrinsics, depth: Intrinsics, parallax_px: Array | float = 0.0
) -> NDArray[np.uint8]:
    """Return the colour of each depth pixel, (H, W, 3), seen by a camera with parallel axes.

    ``parallax_px`` (H, W) is the shift of a pixel along a row because the cameras stand side by
    side; it is zero if they stand at the same place.
    """
    x_per_z, y_per_z = ray_slopes(depth)
    u = (x_per_z * camera.fx + camera.cx + parallax_px).astype(np.float32)
    v = (y_per_z * camera.fy + camera.cy).astype(np.float32)
    shape = (depth.height, depth.width)
    columns, rows = np.broadcast_to(u, shape), np.broadcast_to(v[:, None], shape)
    found = cv2.remap(
        rgb, np.ascontiguousarray(columns), np.ascontiguousarray(rows), cv2.INTER_LINEAR
    )
    return np.asarray(found, dtype=np.uint8)


def read_lines(
    path: Path, expected: str, *, keep_empty: bool = False
) -> Iterator[tuple[str, list[str]]]:
    """Yield where each line of a text file stands, and its words; not of # lines.

    Empty lines are left out as well, unless lines are counted: ``keep_empty``.

    Raises
    ------
    DatasetError
        If the file cannot be read or is no text; the message ends with ``expected``.
    """
    try:
        text = read_text(path)
    except FileNotFoundError:
        raise DatasetError(f"{path}: found no such file, expected {expected}") from None
    except UnicodeDecodeError:
        raise DatasetError(f"{path}: found binary data, expected {expected}") from None
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read ({error.strerror}), expected {expected}") from (
            error
        )
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.split()
        if (words or keep_empty) and not line.lstrip().startswith("#"):
            yield f"{path}, line {number}", words


def check_stamps(stamps_s: Array, where: Path) -> None:
    """Check that times (N,) are finite and strictly increase; ``DatasetError`` names the first."""
    for i in np.flatnonzero(~np.isfinite(stamps_s)).tolist():
        raise DatasetError(f"{where}: found {stamps_s[i]} as time of frame {i}, expected seconds")
    for i in np.flatnonzero(np.diff(stamps_s) <= 0.0).tolist():
        raise DatasetError(
            f"{where}: found frame {i + 1} at {stamps_s[i + 1]:.6f} s after {stamps_s[i]:.6f} s, "
            "expected strictly increasing timestamps"
        )


def nearest(stamps_s: Array, wanted_s: Array, tolerance_s: float) -> NDArray[np.int64]:
    """Return for each wanted time (N,) the index of the nearest stamp, -1 if none is near.

    >>> nearest(np.array([0.0, 1.0, 2.0]), np.array([0.9, 1.4, 5.0]), 0.2).tolist()
    [1, -1, -1]
    """
    if len(stamps_s) == 0:
        return np.full(len(wanted_s), -1)
    order = np.argsort(stamps_s, kind="stable")
    found: NDArray[np.int64] = order[nearest_stamps(wanted_s, stamps_s[order])].astype(np.int64)
    found[np.abs(stamps_s[found] - wanted_s) > tolerance_s] = -1
    return found


def poses_at(trajectory: Trajectory, stamps_s: Array, max_gap_s: float) -> Trajectory:
    """Return a pose for each frame, none left out and none moved to another place.

    Poses are interpolated on the geodesic between the two recorded poses around the frame's
    time. Where those are more than ``max_gap_s`` apart, where one of them is unknown, and
    before the first and after the last, the pose is NaN: unknown.
    """
    poses = np.full((len(stamps_s), 4, 4), np.nan)
    times = trajectory.stamps_s
    if len(times) == 0:
        return Trajectory(stamps_s, poses)
    after = np.clip(np.searchsorted(times, stamps_s), 0, len(times) - 1)
    exact = times[after] == stamps_s
    before = np.where(exact, after, np.maximum(after - 1, 0))
    span_s = times[after] - times[before]
    known = exact | ((times[before] < stamps_s) & (stamps_s < times[after]))
    known &= span_s <= max_gap_s
    known &= np.isfinite(trajectory.poses[[before, after]]).all(axis=(0, 2, 3))
    if known.any():
        b, a = before[known], after[known]
        span = np.where(span_s[known] > 0, span_s[known], 1.0)
        fraction = (stamps_s[known] - times[b]) / span
        poses[known] = se3.interpolate(trajectory.poses[b], trajectory.poses[a], fraction[:, None])
    return Trajectory(stamps_s, poses)


def read_groundtruth(path: Path, stamps_s: Array) -> Trajectory | None:
    """Return the true pose of each frame by a file in TUM format, with a warning for unknown ones.

    None if there is no such file, or it fits no frame.
    """
    if not path.is_file():
        return None
    recorded = read_tum(path)
    found = poses_at(recorded, stamps_s, MAX_GAP_S)
    n_unknown = int(np.isnan(found.poses).any(axis=(1, 2)).sum())
    if n_unknown:
        times = ""
        if n_unknown == len(stamps_s) and len(recorded):
            times = (
                f" (poses from {recorded.stamps_s[0]:.3f} to {recorded.stamps_s[-1]:.3f} s, frames "
                f"from {stamps_s[0]:.3f} to {stamps_s[-1]:.3f} s)"
            )
        logger.warning("%s: no pose near %d of %d frames%s", path, n_unknown, len(stamps_s), times)
    return found if n_unknown < len(stamps_s) else None


def _read_image(path: Path | None, flags: int) -> NDArray[np.uint8] | None:
    if path is None or not os.path.isfile(path):
        return None
    image = decode_image(read_bytes(path), flags)
    if image is None:
        logger.warning("%s: colour image cannot be read", path)
        return None
    return np.asarray(image, np.uint8)
