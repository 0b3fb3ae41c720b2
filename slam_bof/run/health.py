"""``health.csv``: how each frame of a run was tracked."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import read_text
from slam_bof.errors import RunError
from slam_bof.types import Array, Pose, Step, Trajectory
from slam_bof.visualization import FrameHealth

__all__ = ["HealthLog", "read_health", "write_health"]


class HealthLog:
    """Keeps the health of each frame, and writes it to a file as the run goes on.

    The map does not contain it. A resumed run takes that of restored frames from the file. Without
    the file it is unknown which directions were open in them; they count as 0.

    Attributes
    ----------
    frames
        The health of every frame so far.
    """

    def __init__(self) -> None:
        self.frames: list[FrameHealth] = []
        self._poses: list[Pose | None] = []
        self._known: list[FrameHealth] = []
        self._file: TextIO | None = None

    @contextmanager
    def saved_in(self, path: Path, n_restored: int) -> Iterator[None]:
        """Write frames to a file, from which the first ``n_restored`` are read."""
        with suppress(RunError):  # a damaged file must not keep the run from being resumed
            self._known = read_health(path)[:n_restored]
        with path.open("w", newline="", encoding="utf-8", buffering=1) as self._file:
            csv.writer(self._file).writerows([FrameHealth._fields, *self._known])
            yield
        self._file = None

    def add(self, step: Step) -> None:
        """Add the next frame."""
        n = len(self.frames)
        self._poses.append(step.T_map_camera)
        if n < len(self._known):
            self.frames.append(self._known[n])
            return
        self.frames.append(_health_of(step))
        if self._file is not None:
            csv.writer(self._file).writerow(self.frames[-1])

    def trajectory(self, stamps_s: Array) -> Trajectory | None:
        """Return the pose of each frame as it was known at the time; None if some are unknown."""
        poses = [T for T in self._poses if T is not None]
        if len(poses) < len(stamps_s) or not poses:
            return None
        return Trajectory(stamps_s, np.array(poses))


def _health_of(step: Step) -> FrameHealth:
    if step.covariance is None:
        return FrameHealth(step.health, step.open_axes.shape[1])
    variances = np.diag(step.covariance).reshape(2, 3).sum(axis=1)
    return FrameHealth(step.health, step.open_axes.shape[1], *np.sqrt(variances).tolist())


def write_health(
    path: Path,
    stamps_s: NDArray[np.floating],
    health: Sequence[FrameHealth],
    keyframe_frames: Sequence[int],
    components: NDArray[np.intp],
) -> None:
    """Write one row for each frame: time, tracking, uncertainty, component of the map.

    The component, that of the newest keyframe so far, is empty where tracking was lost.
    ``keyframe_frames`` are the frames of the keyframes, whose ``components`` are given.
    """
    newest = np.searchsorted(keyframe_frames, np.arange(len(stamps_s)), "right")
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["stamp_s", *FrameHealth._fields, "component"])
        for stamp_s, frame, n in zip(stamps_s, health, newest, strict=True):
            is_known = n > 0 and frame.health != "lost"
            writer.writerow([stamp_s, *frame, components[n - 1] if is_known else ""])


def read_health(path: Path) -> list[FrameHealth]:
    """Read health.csv; empty for a run of a version that did not write it."""
    try:
        text = read_text(path) if path.is_file() else ""
        rows = csv.DictReader(text.splitlines())
        return [
            FrameHealth(
                row["health"],
                int(row["n_open"]),
                float(row.get("sigma_m", "nan")),
                float(row.get("sigma_rad", "nan")),
            )
            for row in rows
        ]
    except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
        raise RunError(
            f"{path}: found {str(error)[:80]!r}, expected columns health, n_open"
        ) from error
