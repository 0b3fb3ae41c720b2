"""The poses of somebody else's system, from a file: TUM, KITTI, .npy, or a ROS bag."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import open_npy, read_text
from slam_bof.errors import DatasetError, PluginError
from slam_bof.geometry import AXES, read_kitti, read_tum, se3
from slam_bof.types import DepthFrame, Params, Pose, Trajectory

__all__ = ["RecordedOdometry", "RecordedParams"]

logger = logging.getLogger(__name__)

BAGS = (".bag", ".mcap", ".db3")
EDGE_S = 0.02
"""Time before the first stamp and after the last for which that pose holds: stamps are rounded."""
MAX_WAIT_S = 60.0
"""A recording that begins later than this after the first frame is by another clock."""


class RecordedParams(Params):
    """The trajectory to play back, and how it fits the frames."""

    file: Path = Field(
        description="File with the trajectory: TUM lines, KITTI lines, a NumPy array, or a ROS bag."
    )
    format: Literal["auto", "tum", "kitti", "npy", "bag"] = Field(
        "auto",
        description="Format of the file; auto decides by its name (.npy, bags) or the count of "
        "numbers in a line.",
    )
    topic: str | None = Field(
        None, description="Topic in a bag; by default its only nav_msgs/Odometry, poses or tf."
    )
    world_frame: str = Field("odom", description="Frame that poses from tf in a bag refer to.")
    camera_frame: str | None = Field(
        None,
        description="Frame of tf in a bag that moves; by default the frame of its depth images.",
    )
    convention: Literal["camera", "ros", "opengl"] = Field(
        "camera",
        description="Axes of the moving frame: camera (z forward, y down), ros (x forward, z up) "
        "or opengl (z backward, y up).",
    )
    world_to_camera: bool = Field(
        False, description="Whether the file has the inverse poses, from the world to the camera."
    )
    relative: bool = Field(
        True,
        description="Whether poses are relative to that of the first frame; otherwise they stay in "
        "the recorded world, whose direction of gravity is often known (gravity_odom).",
    )
    offset_s: float = Field(0.0, description="Time in seconds added to the recorded time stamps.")
    max_gap_s: float = Field(
        0.25, gt=0, description="Poses farther apart than this many seconds are not interpolated."
    )


class RecordedOdometry:
    """Plays back a trajectory.

    Poses are matched with frames by time and interpolated on the geodesic between two of them.
    A file without stamps (KITTI; .npy of (N, 4, 4), (N, 3, 4) or (N, 12)) is matched by number:
    the first frame has the first pose. The first frame that has a pose is the identity, so that
    poses are relative to it, as of any odometry, unless ``relative`` is off.

    A frame without a pose (before or after the recording, or in a gap) repeats the last one;
    the next that has one is where the recording has it. ``LoopCloser`` tracks such frames by
    what they see, or calls them lost.

    Raises
    ------
    DatasetError
        If the file cannot be read, or by its stamps has nothing to do with the first frame.
    PluginError
        If it is a bag, and the library that reads bags is not installed.
    """

    Params = RecordedParams

    def __init__(self, params: RecordedParams) -> None:
        self.params = params
        recorded, self._has_stamps = _read(params)
        known = np.isfinite(recorded.poses).all(axis=(1, 2))
        if not known.any():
            raise DatasetError(f"{params.file}: found no pose, expected at least one")
        T = se3.nearest_pose(recorded.poses[known])
        if params.world_to_camera:
            T = se3.inverse(T)
        self._T_world_camera = T @ se3.pose(AXES[params.convention], np.zeros(3))
        self._stamps_s = recorded.stamps_s[known]
        if self._has_stamps:
            self._stamps_s = self._stamps_s + params.offset_s
        self.reset()

    def reset(self) -> None:
        """Start again: the next frame is the first one."""
        self._n_frames = 0
        self._T_odom_world: Pose | None = None if self.params.relative else np.eye(4)
        self._T_odom_camera = np.eye(4) if self.params.relative else self._T_world_camera[0]
        self._holds = False

    def state(self) -> dict[str, NDArray[Any]]:
        """Return the number of frames, whether a pose holds, the world's pose and the last one."""
        worlds = np.empty((0, 4, 4)) if self._T_odom_world is None else self._T_odom_world[None]
        return {
            "n_frames": np.array(self._n_frames),
            "holds": np.array(self._holds),
            "T_odom_world": worlds,
            "T_odom_camera": self._T_odom_camera.copy(),
        }

    def restore(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from a state of ``state``; ``ValueError`` if it is none."""
        try:
            n_frames, holds = int(state["n_frames"]), bool(state["holds"])
            worlds = [se3.checked_pose(T) for T in state["T_odom_world"]]
            T_odom_camera = se3.checked_pose(state["T_odom_camera"])
        except (KeyError, TypeError, OverflowError) as error:
            raise ValueError(f"found no state of recorded odometry ({error})") from None
        self._n_frames, self._holds = n_frames, holds
        self._T_odom_world = worlds[0] if worlds else None
        self._T_odom_camera = T_odom_camera

    def process(self, frame: DepthFrame) -> Pose:
        """Return the recorded ``T_odom_camera`` (4, 4) at the frame's time, whatever it shows."""
        stamp_s = frame.stamp_s if self._has_stamps else float(self._n_frames)
        if self._n_frames == 0:
            self._check_clock(stamp_s)
        self._n_frames += 1
        T_world_camera = self._at(stamp_s)
        if (T_world_camera is None) != self._holds:
            self._holds = T_world_camera is None
            logger.warning("%.3f s: recorded poses %s", stamp_s, "end" if self._holds else "go on")
        if T_world_camera is not None:
            if self._T_odom_world is None:
                self._T_odom_world = se3.inverse(T_world_camera)
            self._T_odom_camera = self._T_odom_world @ T_world_camera
        return self._T_odom_camera.copy()

    def _at(self, stamp_s: float) -> Pose | None:
        """Return ``T_world_camera`` at a time, if it is recorded."""
        after = int(np.searchsorted(self._stamps_s, stamp_s))
        for near in (after, after - 1):
            if 0 <= near < len(self._stamps_s) and self._stamps_s[near] == stamp_s:
                found: Pose = self._T_world_camera[near]
                return found
        if after in (0, len(self._stamps_s)):
            nearest = min(after, len(self._stamps_s) - 1)
            apart_s = abs(float(self._stamps_s[nearest]) - stamp_s)
            found = self._T_world_camera[nearest]
            return found if apart_s <= EDGE_S else None
        before_s, after_s = self._stamps_s[after - 1 : after + 1]
        if not self._has_stamps or after_s - before_s > self.params.max_gap_s:
            return None
        return se3.interpolate(
            self._T_world_camera[after - 1],
            self._T_world_camera[after],
            float((stamp_s - before_s) / (after_s - before_s)),
        )

    def _check_clock(self, stamp_s: float) -> None:
        first_s, last_s = float(self._stamps_s[0]), float(self._stamps_s[-1])
        if self._has_stamps and not first_s - MAX_WAIT_S <= stamp_s <= last_s + EDGE_S:
            raise DatasetError(
                f"{self.params.file}: found poses from {first_s:.3f} to {last_s:.3f} s, expected "
                f"some at the first frame, {stamp_s:.3f} s; offset_s shifts them"
            )


def _read(params: RecordedParams) -> tuple[Trajectory, bool]:
    """Return the trajectory of the file, and whether it has stamps or counts."""
    kind = params.format
    if kind == "auto":
        kind = _format_by_name(params.file) or _text_format(params.file)
    if kind == "bag":
        return _read_bag(params), True
    if kind == "tum":
        return read_tum(params.file), True
    return (read_kitti(params.file), False) if kind == "kitti" else _read_npy(params.file)


def _format_by_name(file: Path) -> Literal["npy", "bag", ""]:
    if file.suffix == ".npy":
        return "npy"
    return "bag" if file.suffix.lower() in BAGS or file.is_dir() else ""


def _read_bag(params: RecordedParams) -> Trajectory:
    try:
        from slam_bof_plugins.bag_odometry import read_bag_odometry
    except ModuleNotFoundError as error:
        raise PluginError(
            f"{params.file}: a bag needs {error.name}, which is not installed; "
            'try: pip install "slam-bof[bag]"'
        ) from error
    return read_bag_odometry(
        params.file,
        topic=params.topic,
        camera_frame=params.camera_frame,
        world_frame=params.world_frame,
        max_gap_s=params.max_gap_s,
    )


def _text_format(file: Path) -> Literal["tum", "kitti"]:
    """Distinguish TUM from KITTI by the first line of numbers; TUM where it is neither."""
    try:
        for line in read_text(file, "replace").splitlines():
            if line.strip() and not line.lstrip().startswith("#"):
                return "kitti" if len(line.split()) == 12 else "tum"
    except OSError:
        pass  # read_tum says so
    return "tum"


def _read_npy(file: Path) -> tuple[Trajectory, bool]:
    """Read (N, 8) rows in the order of TUM files, or poses (N, 4, 4), (N, 3, 4) or (N, 12)."""
    try:
        found = open_npy(file)
    except (OSError, ValueError) as error:
        reason = " ".join(str(getattr(error, "strerror", None) or error).split())
        raise DatasetError(f"{file}: cannot be read ({reason}), expected a NumPy array") from None
    shape = np.shape(found)
    if len(shape) == 2 and shape[1] == 8 and found.dtype.kind in "fiu":
        table = found.astype(np.float64)
        norms = np.linalg.norm(table[:, 4:], axis=1)
        if not np.isfinite(table).all() or (np.diff(table[:, 0]) <= 0).any():
            raise DatasetError(f"{file}: expected finite rows with strictly increasing timestamps")
        if (farthest_m := np.abs(table[:, 1:4]).max(initial=0.0)) > se3.MAX_POSITION_M:
            raise DatasetError(f"{file}: found a position at {farthest_m:g} m, expected metres")
        if (np.abs(norms - 1.0) > se3.TOLERANCE).any():
            worst = norms[np.abs(norms - 1.0).argmax()]
            raise DatasetError(f"{file}: found a quaternion of norm {worst:.6g}, expected 1")
        return Trajectory(table[:, 0], se3.from_quaternion(table[:, 4:], table[:, 1:4])), True
    if shape[1:] not in ((4, 4), (3, 4), (12,)) or found.dtype.kind not in "fiu":
        raise DatasetError(
            f"{file}: found an array {shape} of {found.dtype}, expected numbers (N, 8) as in TUM's "
            "format, or poses (N, 4, 4), (N, 3, 4) or (N, 12)"
        )
    poses = np.tile(np.eye(4), (shape[0], 1, 1))
    poses[:, :3] = found.reshape(-1, int(np.prod(shape[1:])))[:, :12].reshape(-1, 3, 4)
    for number, T in enumerate(poses):
        try:
            if not np.isnan(T).any():
                se3.check_rigid(T)
        except ValueError as error:
            raise DatasetError(f"{file}, pose {number}: {error}") from None
    poses[np.isnan(poses).any(axis=(1, 2))] = np.nan
    return Trajectory(np.arange(shape[0], dtype=np.float64), poses), False
