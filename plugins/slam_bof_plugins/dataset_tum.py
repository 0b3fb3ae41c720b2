"""TUM RGB-D benchmark (Sturm et al., IROS 2012): depth, colour and motion capture by time.

``SEQUENCE/depth.txt`` and ``rgb.txt`` list lines ``stamp_s file``, ``groundtruth.txt`` lines
``stamp_s tx ty tz qx qy qz qw`` (T_world_camera). Depth is uint16, 5000 a metre, 0 where missing.

The frames are those of ``depth.txt``, at its times and in its order; listed images that are not
there are left out with a warning. Colour is the nearest image within 0.02 s. The true pose is
interpolated between the two recorded ones around a frame, if they are at most 0.1 s apart; else
it is unknown (NaN), and the frame stays.
"""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_intrinsics
from slam_bof.types import Array, DepthFrame, Intrinsics, Params, Trajectory
from slam_bof_plugins.dataset_files import (
    check_depth_files,
    check_stamps,
    nearest,
    read_gray,
    read_groundtruth,
    read_lines,
    read_rgb,
    scale_depth,
    sequence_name,
)
from slam_bof_plugins.depth_png import read_depth_png

__all__ = ["TumParams", "TumRgbd"]

logger = logging.getLogger(__name__)

UNITS_PER_M = 5000.0
COLOR_TOLERANCE_S = 0.02
"""Largest difference of the times of a depth and a colour image, as in the benchmark's tools."""

Camera = Literal["color", "infrared", "default"]

# fx, fy, cx, cy of 640x480 images, as published with the benchmark, by camera and freiburg
# number. Depth there is registered to colour already, so that the colour camera is right for
# both; the infrared camera is for raw depth. The depth values of freiburg1 and freiburg2 were
# corrected (by 1.035 and 1.031) before publication: nothing is to be done about them here. Lens
# distortion, of colour images of freiburg1 and freiburg2, is not undone.
CAMERAS: dict[tuple[str, int], tuple[float, float, float, float]] = {
    ("color", 1): (517.3, 516.5, 318.6, 255.3),
    ("color", 2): (520.9, 521.0, 325.1, 249.7),
    ("color", 3): (535.4, 539.2, 320.1, 247.6),
    ("infrared", 1): (591.1, 590.1, 331.0, 234.0),
    ("infrared", 2): (580.8, 581.8, 308.8, 253.0),
    ("infrared", 3): (567.6, 570.2, 324.7, 250.1),
}
DEFAULT_CAMERA = (525.0, 525.0, 319.5, 239.5)
"""Focal length of the OpenNI driver, for sequences in this format from other cameras."""


class TumParams(Params):
    """The camera that took the images."""

    camera: Camera = Field(
        "color",
        description="Published intrinsics to use: color (depth registered to it, as distributed),"
        " infrared (raw depth), or default (525 px, the default of OpenNI).",
    )
    intrinsics: tuple[float, float, float, float] | None = Field(
        None, description="Intrinsics fx, fy, cx, cy in pixels, used instead of the published ones."
    )


class TumRgbd:
    """One sequence of the TUM RGB-D benchmark, or in its layout."""

    name: ClassVar[str] = "tum"
    units_per_m: ClassVar[float] = UNITS_PER_M
    Params = TumParams

    def __init__(
        self, folder: Path, stamps_s: Array, files: Sequence[Path], intrinsics: Intrinsics
    ) -> None:
        self.folder = folder
        self.sequence = sequence_name(folder)
        self.intrinsics = intrinsics
        self._stamps_s = stamps_s
        self._files = tuple(files)
        self._colors = _match_colors(folder, stamps_s)
        self._groundtruth = read_groundtruth(folder / "groundtruth.txt", stamps_s)

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the files that identify the format; empty if there are none."""
        if not (path / "depth.txt").is_file():
            return ""
        found = [name for name in ("rgb.txt", "groundtruth.txt") if (path / name).is_file()]
        if not found and not (path / "depth").is_dir():
            return ""
        return ", ".join(["depth.txt", *(found or ["depth/"])])

    @classmethod
    def open(cls, path: Path, params: TumParams | None = None) -> Self:
        """Open the folder of a sequence.

        Raises
        ------
        DatasetError
            If a list is missing or malformed, or its times do not grow; if no listed depth image
            is there, one is of 8 bits, in colour or of another size; if no line of
            ``groundtruth.txt`` is a pose.
        """
        stamps_s, files = _read_list(path / "depth.txt")
        present = [
            i for i, file in enumerate(files) if os.path.isfile(file)
        ]  # is_file raises for long names
        if not present:
            raise DatasetError(
                f"{path / 'depth.txt'}: found {len(files)} images listed and none of them there, "
                f"expected depth images such as {str(files[0])[-80:] if files else 'depth/0.png'}"
            )
        if len(present) < len(files):
            logger.warning(
                "%s: %d of %d listed depth images are not there, the first %s; left out",
                path / "depth.txt",
                len(files) - len(present),
                len(files),
                next(file.name[:80] for file in files if not os.path.isfile(file)),
            )
        files = [files[i] for i in present]
        height, width = check_depth_files(files)
        camera = _camera(path, params or TumParams(), width, height)
        return cls(path, stamps_s[present], files, camera)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._files)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame, at its time in ``depth.txt``; depth is float32 m."""
        depth = scale_depth(read_depth_png(self._files[index]), UNITS_PER_M)
        return DepthFrame(float(self._stamps_s[index]), depth, self.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image (H, W, 3) nearest in time: depth is registered to it."""
        return read_rgb(self._colors[index])

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the same in grey, (H, W)."""
        return read_gray(self._colors[index])

    def groundtruth(self) -> Trajectory | None:
        """Return a pose for each frame, NaN where motion capture saw nothing near its time."""
        return self._groundtruth

    def scenes(self) -> None:
        """Return None: no labels."""


def _read_list(path: Path) -> tuple[Array, list[Path]]:
    stamps_s, files = [], []
    for where, words in read_lines(path, "lines of stamp and file name"):
        stamp_s = _number(words[0])
        name = PurePosixPath(words[-1])
        if len(words) != 2 or not math.isfinite(stamp_s):
            raise DatasetError(
                f"{where}: found {' '.join(words)[:80]!r}, expected a stamp and a file"
            )
        if name.is_absolute() or ".." in name.parts:
            raise DatasetError(
                f"{where}: found {words[1][:80]!r}, expected a file below the sequence"
            )
        stamps_s.append(stamp_s)
        files.append(path.parent / name)
    found = np.array(stamps_s)
    check_stamps(found, path)
    return found, files


def _number(word: str) -> float:
    try:
        return float(word)
    except ValueError:
        return math.nan


def _match_colors(folder: Path, stamps_s: Array) -> tuple[Path | None, ...]:
    if not (folder / "rgb.txt").is_file():
        return (None,) * len(stamps_s)
    color_stamps_s, files = _read_list(folder / "rgb.txt")
    matches = nearest(color_stamps_s, stamps_s, COLOR_TOLERANCE_S)
    return tuple(files[i] if i >= 0 else None for i in matches.tolist())


def _camera(folder: Path, params: TumParams, width: int, height: int) -> Intrinsics:
    if params.intrinsics is not None:
        return checked_intrinsics("dataset.options.intrinsics", width, height, *params.intrinsics)
    which = params.camera
    match = re.search(r"freiburg([123])", folder.resolve().name)
    if which != "default" and match is None:
        logger.warning(
            "%s: the name contains no freiburg1, 2 or 3; taking the default camera of 525 px, "
            "or give --set dataset.options.intrinsics=[fx,fy,cx,cy]",
            folder,
        )
    of_freiburg = (which, int(match[1])) if match else (which, 0)
    fx, fy, cx, cy = CAMERAS.get(of_freiburg, DEFAULT_CAMERA)
    scale = width / 640
    return Intrinsics(width, height, fx * scale, fy * scale, cx * scale, cy * scale)
