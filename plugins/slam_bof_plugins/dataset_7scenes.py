"""Microsoft 7-Scenes (Shotton et al., CVPR 2013), and whatever else is written in its layout.

``SCENE/seq-XX/frame-XXXXXX.{depth.png,color.png,pose.txt}``, where ``SCENE`` also has
``TrainSplit.txt`` and ``TestSplit.txt``. Depth is uint16 mm, 0 and 65535 where missing; poses
are camera-to-world, of the depth camera. Colour and poses may be missing, and colour may be JPEG.
Numbers may have any number of digits.
"""

from __future__ import annotations

import csv
import io
import logging
import re
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import ClassVar, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.core import decode_image, read_bytes, read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3, warn_unknown
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose, Trajectory
from slam_bof_plugins.dataset_files import register
from slam_bof_plugins.depth_png import check_header, read_depth_png

__all__ = ["SevenScenes"]

logger = logging.getLogger(__name__)

FRAMES_PER_S = 30.0
FRAME = re.compile(r"(frame-\d+)\.depth\.png")
COLOR_SUFFIXES = (".color.png", ".color.jpg")
SPLITS = ("TrainSplit.txt", "TestSplit.txt")

# Of images 640 pixels wide; other sizes scale with the width.
DEPTH_FOCAL_PX = 585.0
COLOR_FOCAL_PX = 525.0
T_COLOR_DEPTH_X_M = -0.026  # where the two cameras' edges meet best
ROTATION_TOLERANCE = 1e-2


class SevenScenes:
    """One sequence in 7-Scenes layout."""

    name: ClassVar[str] = "7scenes"
    units_per_m: ClassVar[float] = 1000.0

    def __init__(self, folder: Path, stems: Sequence[str], intrinsics: Intrinsics) -> None:
        self.folder = folder
        self.sequence = "/".join(folder.resolve().parts[-2:])
        self.intrinsics = intrinsics
        self._stems, self._numbers = tuple(stems), tuple(map(_number, stems))
        self._groundtruth = self._read_groundtruth()
        self._scenes = self._read_scenes()

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return what identifies a sequence, or a scene with sequences; empty if it is neither."""
        if not path.is_dir():
            return ""
        if stems := _frame_stems(path):
            return f"{stems[0]}.depth.png"
        sequences = _sequences(path)
        return f"{sequences[0].name}/ with frame-XXXXXX.depth.png" if sequences else ""

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open a ``seq-XX`` folder, or a scene folder that has one sequence only.

        Raises
        ------
        DatasetError
            If there is no such folder or sequence, or several; if two files have one number; if a
            depth image is of 8 bits, in colour, or of another size than the first.
        """
        folder = _sequence_folder(path)
        stems = _frame_stems(folder)
        first, *others = (folder / f"{stem}.depth.png" for stem in stems)
        for one, other in pairwise(stems):
            if _number(one) == _number(other):
                raise DatasetError(
                    f"{folder}: found {one}.depth.png and {other}.depth.png, expected one file "
                    "for each frame number"
                )
        height, width = read_depth_png(first).shape
        for file in others:
            check_header(file, (height, width))
        return cls(folder, stems, _camera(DEPTH_FOCAL_PX, width, height))

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._numbers)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame; its time is its number in the file's name, at 30 Hz."""
        depth = read_depth_png(self._file(index, ".depth.png"))
        return DepthFrame(self._numbers[index] / FRAMES_PER_S, depth, self.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image and move its pixels (H, W, 3) to where depth sees them."""
        image = self._color_image(index, cv2.IMREAD_COLOR)
        if image is None:
            return None
        rgb = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB), dtype=np.uint8)
        return _register(rgb, self.frame(index))

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image as it was recorded, in grey, (H, W)."""
        return self._color_image(index, cv2.IMREAD_GRAYSCALE)

    def groundtruth(self) -> Trajectory | None:
        """Return the poses, NaN for frames without; None if no frame has one."""
        return self._groundtruth

    def scenes(self) -> tuple[str, ...] | None:
        """Return the labels of ``scenes.csv`` (columns frame, scene), if there is that file."""
        return self._scenes

    def _color_image(self, index: int, flags: int) -> NDArray[np.uint8] | None:
        for suffix in COLOR_SUFFIXES:
            file = self._file(index, suffix)
            if file.is_file():
                image = decode_image(read_bytes(file), flags)
                if image is None:
                    logger.warning("%s: colour image cannot be read", file)
                    return None
                return np.asarray(image, np.uint8)
        return None

    def _file(self, index: int, suffix: str) -> Path:
        return self.folder / f"{self._stems[index]}{suffix}"

    def _read_groundtruth(self) -> Trajectory | None:
        files = [self._file(i, ".pose.txt") for i in range(len(self))]
        poses = np.full((len(self), 4, 4), np.nan)
        problems = []
        for index, file in enumerate(files):
            try:
                if file.is_file():
                    poses[index] = _read_pose(file)
            except (OSError, ValueError) as error:
                problems.append(f"{file.name}: {error}")
        warn_unknown(self.folder, problems, len(self))
        if not np.isfinite(poses).any():
            return None
        return Trajectory(np.array(self._numbers) / FRAMES_PER_S, poses)

    def _read_scenes(self) -> tuple[str, ...] | None:
        file = self.folder / "scenes.csv"
        if not file.is_file():
            return None
        try:
            lines = io.StringIO(read_text(file), newline="")
            labels = {int(row["frame"]): row["scene"] for row in csv.DictReader(lines)}
            return tuple(labels[number] for number in self._numbers)
        except (OSError, KeyError, TypeError, ValueError, csv.Error) as error:
            raise DatasetError(
                f"{file}: found {error!r}, expected columns frame,scene with every frame"
            ) from error


def _frame_stems(folder: Path) -> list[str]:
    """Return what the files of each frame begin with, such as "frame-000123", by number."""
    matches = (FRAME.fullmatch(file.name) for file in folder.iterdir())
    return sorted((match[1] for match in matches if match), key=lambda stem: (_number(stem), stem))


def _number(stem: str) -> int:
    return int(stem.removeprefix("frame-"))


def _sequences(scene: Path) -> list[Path]:
    return sorted(f for f in scene.glob("seq-*") if f.is_dir() and _frame_stems(f))


def _sequence_folder(path: Path) -> Path:
    if not path.is_dir():
        found = "a file" if path.exists() else "nothing"
        raise DatasetError(f"{path}: found {found}, expected the folder of a sequence")
    if _frame_stems(path):
        return path
    sequences = _sequences(path)
    if len(sequences) == 1:
        return sequences[0]
    if sequences:
        listed = ", ".join(f"{f.name}{_split_of(path, f)}" for f in sequences)
        raise DatasetError(
            f"{path}: found {len(sequences)} sequences ({listed}), expected one; "
            f"give its folder, such as {sequences[0]}"
        )
    raise DatasetError(
        f"{path}: found neither frame-XXXXXX.depth.png nor seq-XX folders with such files, "
        "expected 7-Scenes layout"
    )


def _split_of(scene: Path, sequence: Path) -> str:
    """Return the split that the scene's split files put a sequence in, such as " train"."""
    number = int(re.sub(r"\D", "", sequence.name) or 0)
    for name in SPLITS:
        file = scene / name
        lines = read_text(file, "replace").split() if file.is_file() else []
        if f"sequence{number}" in lines:
            return f" {name.removesuffix('Split.txt').lower()}"
    return ""


def _camera(focal_px: float, width: int, height: int) -> Intrinsics:
    focal_px *= width / 640
    return Intrinsics(width, height, focal_px, focal_px, width / 2, height / 2)


def _read_pose(file: Path) -> Pose:
    """Read T_world_camera; its rotation, given to a few digits, is made orthonormal.

    ``ValueError`` if the file does not hold a pose: recorders write NaN, zeros or nothing, or
    ``-1.#INF``, where they lost track.
    """
    values = [float(word) for word in read_text(file).split()]
    if len(values) != 16:
        raise ValueError(f"found {len(values)} numbers, expected 16: a pose")
    T = np.array(values).reshape(4, 4)
    if not np.isfinite(T).all():
        raise ValueError("found NaN or infinity, expected a pose")
    if (farthest_m := float(np.abs(T[:3, 3]).max())) > se3.MAX_POSITION_M:
        raise ValueError(f"found a position at {farthest_m:g} m, expected metres")
    R = T[:3, :3]
    off, determinant = np.abs(R @ R.T - np.eye(3)).max(), np.linalg.det(R)
    if off > ROTATION_TOLERANCE or determinant < 0 or T[3].tolist() != [0, 0, 0, 1]:
        raise ValueError(
            f"found no rigid transform (R R^T is off by {off:.3g}, det R = {determinant:.3g}, "
            f"last row {T[3].tolist()}), expected a pose"
        )
    return se3.nearest_pose(T)


def _register(rgb: NDArray[np.uint8], frame: DepthFrame) -> NDArray[np.uint8]:
    """Return the colour of each depth pixel: the cameras stand side by side, axes parallel."""
    camera = _camera(COLOR_FOCAL_PX, rgb.shape[1], rgb.shape[0])
    z_m: Array = frame.depth_m().astype(np.float64)
    # The parallax of a pixel without depth is that of a point far away.
    parallax_px = np.divide(
        camera.fx * T_COLOR_DEPTH_X_M, z_m, out=np.zeros_like(z_m), where=z_m > 0
    )
    return register(rgb, camera, frame.intrinsics, parallax_px)
