"""ScanNet (Dai et al., CVPR 2017): one .sens file, or the folder of a scan that has one.

Poses are T_world_camera; those that tracking lost are -inf there and NaN (unknown) here. Times
are the file's, in microseconds; where they do not grow (some files have zeros), 30 Hz is assumed.
Depth and colour camera stand at the same place by the file's own extrinsics.
"""

from __future__ import annotations

import logging
from pathlib import Path
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.core import decode_image
from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_intrinsics, se3, warn_unknown
from slam_bof.types import Array, DepthFrame, Intrinsics, Trajectory
from slam_bof_plugins.dataset_files import register, scale_depth, sequence_name
from slam_bof_plugins.sens_file import SensFile, is_sens, open_sens

__all__ = ["ScanNet"]

logger = logging.getLogger(__name__)

FRAMES_PER_S = 30.0


class ScanNet:
    """One scan of ScanNet."""

    name: ClassVar[str] = "scannet"

    def __init__(self, sens: SensFile) -> None:
        self._sens = sens
        self.units_per_m = sens.units_per_m
        self.sequence = sequence_name(sens.path.with_suffix(""))
        self.intrinsics = _camera(sens.path, sens.K_depth, sens.depth_size)
        self._stamps_s = _times(sens)
        self._groundtruth = _groundtruth(sens, self._stamps_s)

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the file that identifies the format; empty if there is none."""
        files = _sens_files(path)
        return f"{files[0].name}: .sens version 4" if files and is_sens(files[0]) else ""

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a .sens file, or the only one in a folder.

        Raises
        ------
        DatasetError
            If there is none or several, or it is truncated, of another version or without
            frames.
        """
        files = _sens_files(path)
        if len(files) != 1:
            found = ", ".join(file.name for file in files[:3]) or "no .sens file"
            raise DatasetError(f"{path}: found {found}, expected one .sens file")
        sens = open_sens(files[0])
        if len(sens.places) == 0:
            raise DatasetError(f"{files[0]}: found no frames, expected a scan")
        sens.read_depth(0)
        return cls(sens)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._stamps_s)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame: uint16 mm where 1000 units are a metre, as is usual, else float32 m."""
        depth = scale_depth(self._sens.read_depth(index), self._sens.units_per_m)
        return DepthFrame(float(self._stamps_s[index]), depth, self.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image and move its pixels (H, W, 3) to where depth sees them."""
        sens = self._sens
        bgr = self._color_image(index, cv2.IMREAD_COLOR) if sens.K_color[0, 0] > 0.0 else None
        if bgr is None:
            return None
        rgb = np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8)
        camera = _camera(f"{sens.path}: colour", sens.K_color, sens.color_size)
        return register(rgb, camera, self.intrinsics)

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image as it was recorded, in grey, (H, W)."""
        return self._color_image(index, cv2.IMREAD_GRAYSCALE)

    def groundtruth(self) -> Trajectory | None:
        """Return the poses, NaN where tracking was lost; None if it was everywhere."""
        return self._groundtruth

    def scenes(self) -> None:
        """Return None: no labels."""

    def _color_image(self, index: int, flags: int) -> NDArray[np.uint8] | None:
        if self._sens.color_coding not in ("png", "jpeg"):
            return None
        data = self._sens.read_color(index)
        image = decode_image(data, flags)
        if image is None:
            logger.warning("%s: colour image %d cannot be read", self._sens.path, index)
            return None
        return np.asarray(image, np.uint8)


def _sens_files(path: Path) -> list[Path]:
    if path.is_dir():
        return sorted(path.glob("*.sens"))
    return [path] if path.is_file() else []


def _camera(where: Path | str, K: Array, size: tuple[int, int]) -> Intrinsics:
    height, width = size
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return checked_intrinsics(where, width, height, fx, fy, cx, cy)


def _times(sens: SensFile) -> Array:
    since_us = sens.stamps_us.astype(np.float64)
    if (np.diff(since_us) > 0.0).all():
        return np.asarray(since_us * 1e-6)
    logger.warning("%s: times do not grow; taking 30 frames a second", sens.path)
    return np.arange(len(since_us)) / FRAMES_PER_S


def _groundtruth(sens: SensFile, stamps_s: Array) -> Trajectory | None:
    poses = sens.poses.copy()
    lost = ~np.isfinite(poses).all(axis=(1, 2))
    poses[lost] = np.nan
    problems = []
    for index in np.flatnonzero(~lost).tolist():
        T = poses[index].copy()
        try:
            se3.check_rigid(T)
            poses[index] = se3.nearest_pose(T)
        except ValueError as error:
            problems.append(f"frame {index}: {error}")
            poses[index] = np.nan
    warn_unknown(sens.path, problems, len(poses))
    return Trajectory(stamps_s, poses) if np.isfinite(poses).any() else None
