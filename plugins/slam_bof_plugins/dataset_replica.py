"""Replica (Straub et al., 2019) as rendered for NICE-SLAM (Zhu et al., CVPR 2022).

``SCENE/results/{depthXXXXXX.png,frameXXXXXX.jpg}`` and ``SCENE/traj.txt``, whose line N is
T_world_camera (4x4, row by row) of frame N. Depth is uint16, 6553.5 a metre; images are free of
noise and have no times: 30 Hz is assumed. The camera stands in ``cam_params.json`` in the scene
or beside it; without, it is the one that all eight scenes were rendered with.
"""

from __future__ import annotations

import json
import logging
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_depth, checked_intrinsics, se3, warn_unknown
from slam_bof.types import DepthFrame, Intrinsics, Pose, Trajectory
from slam_bof_plugins.dataset_files import (
    check_depth_files,
    read_gray,
    read_lines,
    read_rgb,
    scale_depth,
    sequence_name,
)
from slam_bof_plugins.depth_png import read_depth_png

__all__ = ["Replica"]

logger = logging.getLogger(__name__)

FRAMES_PER_S = 30.0
DEPTH = re.compile(r"depth(\d+)\.png")
KNOWN_CAMERA = {"w": 1200, "h": 680, "fx": 600, "fy": 600, "cx": 599.5, "cy": 339.5}
KNOWN_UNITS_PER_M = 6553.5


class Replica:
    """One scene of Replica, in NICE-SLAM's layout."""

    name: ClassVar[str] = "replica"

    def __init__(
        self,
        folder: Path,
        files: Sequence[Path],
        numbers: Sequence[int],
        intrinsics: Intrinsics,
        units_per_m: float,
    ) -> None:
        self.folder = folder
        self.sequence = sequence_name(folder)
        self.intrinsics = intrinsics
        self.units_per_m = units_per_m
        self._files = tuple(files)
        self._numbers = tuple(numbers)
        self._groundtruth = self._read_groundtruth()

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the files that identify the format; empty if there are none."""
        if not _depth_files(path):
            return ""
        poses = ", traj.txt" if (path / "traj.txt").is_file() else ""
        return f"results/depthXXXXXX.png{poses}"

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the folder of a scene.

        Raises
        ------
        DatasetError
            If there are no depth images, one is of 8 bits, in colour, or not of the camera's
            size.
        """
        found = _depth_files(path)
        if not found:
            raise DatasetError(
                f"{path}: found no results/depthXXXXXX.png, expected Replica in NICE-SLAM's format"
            )
        numbers = sorted(found)
        files = [found[number] for number in numbers]
        intrinsics, units_per_m, source = _read_camera(path)
        height, width = check_depth_files(files)
        if (width, height) != (intrinsics.width, intrinsics.height):
            raise DatasetError(
                f"{files[0]}: found {width}x{height} pixels, "
                f"expected {intrinsics.width}x{intrinsics.height} as {source} has it"
            )
        return cls(path, files, numbers, intrinsics, units_per_m)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._files)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame; its time is its number at 30 Hz, its depth float32 m."""
        file = self._files[index]
        depth = checked_depth(file, scale_depth(read_depth_png(file), self.units_per_m))
        return DepthFrame(self._numbers[index] / FRAMES_PER_S, depth, self.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image, (H, W, 3): rendered by the same camera."""
        return read_rgb(self._color_file(index))

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image in grey, (H, W)."""
        return read_gray(self._color_file(index))

    def groundtruth(self) -> Trajectory | None:
        """Return the poses of ``traj.txt``, NaN where it has none; None without that file."""
        return self._groundtruth

    def scenes(self) -> None:
        """Return None: no labels."""

    def _color_file(self, index: int) -> Path:
        file = self._files[index]
        name = file.stem.replace("depth", "frame")
        jpeg = file.with_name(f"{name}.jpg")
        return jpeg if jpeg.is_file() else file.with_name(f"{name}.png")

    def _read_groundtruth(self) -> Trajectory | None:
        path = self.folder / "traj.txt"
        if not path.is_file():
            return None
        lines = list(read_lines(path, "16 numbers a line: poses", keep_empty=True))
        poses = np.full((len(self), 4, 4), np.nan)
        problems = []
        for index, number in enumerate(self._numbers):
            try:
                poses[index] = _pose(lines[number][1] if number < len(lines) else [])
            except ValueError as error:
                problems.append(f"line {number + 1}: {error}")
        warn_unknown(path, problems, len(self))
        if not np.isfinite(poses).any():
            return None
        return Trajectory(np.array(self._numbers) / FRAMES_PER_S, poses)


def _depth_files(path: Path) -> dict[int, Path]:
    results = path / "results"
    if not results.is_dir():
        return {}
    matches = ((DEPTH.fullmatch(file.name), file) for file in results.iterdir())
    return {int(match[1]): file for match, file in matches if match}


def _read_camera(scene: Path) -> tuple[Intrinsics, float, str]:
    """Return the camera, units of depth a metre, and where they are from."""
    camera: dict[str, Any] = {**KNOWN_CAMERA, "scale": KNOWN_UNITS_PER_M}
    source = "NICE-SLAM, since there is no cam_params.json,"
    for file in (scene / "cam_params.json", scene.resolve().parent / "cam_params.json"):
        if file.is_file():
            camera, source = _read_json(file), file.name
            break
    else:
        logger.info("%s: no cam_params.json; taking the camera of NICE-SLAM's renderings", scene)
    width, height, *pinhole = (camera[key] for key in KNOWN_CAMERA)
    intrinsics = checked_intrinsics(file, int(width), int(height), *map(float, pinhole))
    return intrinsics, float(camera["scale"]), source


def _read_json(file: Path) -> dict[str, Any]:
    expected = f"a camera with positive numbers {', '.join(KNOWN_CAMERA)}, scale"
    try:
        camera: dict[str, Any] = json.loads(read_text(file))["camera"]
        if not all(0.0 < float(camera[key]) < math.inf for key in (*KNOWN_CAMERA, "scale")):
            raise ValueError("a number that is not positive")
    except KeyError as error:
        raise DatasetError(f"{file}: found no key {error}, expected {expected}") from error
    except (OSError, TypeError, ValueError, OverflowError, RecursionError) as error:
        raise DatasetError(f"{file}: found {error!r}, expected {expected}") from error
    return camera


def _pose(words: list[str]) -> Pose:
    if len(words) != 16:
        raise ValueError(f"found {len(words)} numbers, expected 16: a pose")
    T = np.array([float(word) for word in words]).reshape(4, 4)
    se3.check_rigid(T)
    return se3.nearest_pose(T)
