"""A plain folder of depth images with their camera: what ``slam-bof record`` leaves.

``FOLDER/intrinsics.json`` holds ``width height fx fy cx cy`` (px), ``depth_scale`` (units a metre;
by default 1000 for integers and 1 for floats) and ``fps`` (30 by default). Depth images are
``depth/NAME.png`` (16-bit grey) or ``.npy`` (uint16 or float, (H, W)); without that folder, all
``NAME.depth.png``, or else all .png and .npy files, beside ``intrinsics.json``. 0, 65535 and what
is not finite are missing. Suffixes may be in capitals.

Times come from ``timestamps.txt`` (a line for each image: seconds, or its name and seconds), or
else from the names as recorders write them (see ``name_times``): a date, seconds with a decimal
point (``1628069033.660061.png``), milliseconds of RealSense tools; otherwise it is the number of
the image at ``fps``. Times since 1970 may be in s, ms, us or ns. Colour
(``color/NAME.{png,jpg}`` or ``NAME.color.{png,jpg}``) is taken as registered to depth; poses
(``groundtruth.txt`` or ``poses.txt``, TUM format, T_world_camera) are matched as in ``tum``.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field, ValidationError

from slam_bof.core import describe_error, open_npy, read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_depth, checked_intrinsics
from slam_bof.types import Array, DepthFrame, Trajectory
from slam_bof_plugins.dataset_files import (
    check_stamps,
    read_gray,
    read_groundtruth,
    read_lines,
    read_rgb,
    scale_depth,
    sequence_name,
)
from slam_bof_plugins.depth_png import check_header, read_depth_png
from slam_bof_plugins.name_times import as_seconds, times_of_names

__all__ = ["DepthFolder"]

logger = logging.getLogger(__name__)

INTRINSICS = "intrinsics.json"
POSES = ("groundtruth.txt", "poses.txt")
SUFFIXES = (".png", ".npy")
COLOR_SUFFIXES = (".png", ".jpg", ".PNG", ".JPG")


class CameraFile(BaseModel):
    """The content of ``intrinsics.json``; other keys are ignored."""

    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float
    fy: float
    cx: float
    cy: float
    depth_scale: float | None = Field(None, ge=1, allow_inf_nan=False)
    fps: float = Field(30.0, gt=0, allow_inf_nan=False)


class DepthFolder:
    """A folder of depth images."""

    name: ClassVar[str] = "folder"

    def __init__(
        self, folder: Path, files: Sequence[Path], stamps_s: Array, camera: CameraFile
    ) -> None:
        self.folder = folder
        self.sequence = sequence_name(folder)
        self.intrinsics = checked_intrinsics(
            folder / INTRINSICS,
            camera.width,
            camera.height,
            camera.fx,
            camera.fy,
            camera.cx,
            camera.cy,
        )
        self._depth_scale = camera.depth_scale
        self.units_per_m = camera.depth_scale or (1000.0 if _is_png(files[0]) else 1.0)
        self._files = tuple(files)
        self._stamps_s = stamps_s
        self._groundtruth = _read_groundtruth(folder, stamps_s)

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the files that identify the format; empty if there are none."""
        if not (path / INTRINSICS).is_file():
            return ""
        files = _depth_files(path)
        return f"{INTRINSICS}, {files[0].relative_to(path)}" if files else ""

    @classmethod
    def open(cls, path: Path) -> Self:
        """Open the folder.

        Raises
        ------
        DatasetError
            If there are no depth images or no intrinsics; if an image is no 16-bit grey PNG or
            array of numbers, or not of the camera's size; if times do not grow or are missing.
        """
        camera = _read_camera(path / INTRINSICS)
        files = _depth_files(path)
        if not files:
            raise DatasetError(
                f"{path}: found no depth images, expected depth/NAME.png or depth/NAME.npy"
            )
        files, stamps_s = _times(path, files, camera.fps)
        for file in files:
            _check_size(file, (camera.height, camera.width))
        _read_depth(files[0], camera.depth_scale)
        return cls(path, files, stamps_s, camera)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._files)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame; uint16 mm as it is, other scales as float32 m."""
        depth = _read_depth(self._files[index], self._depth_scale)
        return DepthFrame(float(self._stamps_s[index]), depth, self.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image, (H, W, 3), if it is of the size of the depth image."""
        rgb = read_rgb(self._color_file(index))
        size = (self.intrinsics.height, self.intrinsics.width)
        return rgb if rgb is not None and rgb.shape[:2] == size else None

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image in grey, (H, W), of whatever size it is."""
        return read_gray(self._color_file(index))

    def groundtruth(self) -> Trajectory | None:
        """Return a pose for each frame, NaN where none is near its time."""
        return self._groundtruth

    def scenes(self) -> None:
        """Return None: no labels."""

    def _color_file(self, index: int) -> Path | None:
        stem = _stem(self._files[index])
        places = (self.folder / "color" / stem, self.folder / f"{stem}.color")
        candidates = [p.with_name(p.name + s) for p in places for s in COLOR_SUFFIXES]
        return next((file for file in candidates if file.is_file()), None)


def _depth_files(folder: Path) -> list[Path]:
    """Return the depth images, by name."""
    below = folder / "depth"
    for place, pattern in ((below, "*"), (folder, "*.depth.png"), (folder, "*")):
        if place.is_dir():
            files = [f for f in place.glob(pattern) if f.suffix.lower() in SUFFIXES and f.is_file()]
            # A name that begins with a dot is of an image that was not finished.
            files = [f for f in files if not f.name.startswith(".") and ".color." not in f.name]
            if files:
                return sorted(files)
    return []


def _is_png(file: Path) -> bool:
    return file.suffix.lower() == ".png"


def _stem(file: Path) -> str:
    return file.stem.removesuffix(".depth")


def _read_camera(file: Path) -> CameraFile:
    try:
        values = json.loads(read_text(file))
        if not isinstance(values, dict):
            raise ValueError(f"a {type(values).__name__}")
        return CameraFile.model_validate(values)
    except FileNotFoundError:
        raise DatasetError(
            f"{file}: found no such file, expected JSON with width, height, fx, fy, cx, cy"
        ) from None
    except OSError as error:
        raise DatasetError(f"{file}: cannot be read: {error.strerror}") from error
    except ValidationError as error:
        said = describe_error(error, CameraFile)
        hint = "; it is units a metre, such as 1000" if "'depth_scale'" in said else ""
        raise DatasetError(f"{file}: {said}{hint}") from error
    except (ValueError, RecursionError) as error:
        raise DatasetError(f"{file}: found no JSON object ({error}), expected a camera") from error


def _times(folder: Path, files: list[Path], fps: float) -> tuple[list[Path], Array]:
    """Return the images in the order of their times, and the times."""
    listed = folder / "timestamps.txt"
    if listed.is_file():
        return _listed_times(listed, files)
    stamps_s = times_of_names([_stem(file) for file in files], fps)
    order = np.argsort(stamps_s, kind="stable")
    stamps_s = stamps_s[order]
    check_stamps(stamps_s, folder)
    return [files[i] for i in order], stamps_s


def _listed_times(path: Path, files: list[Path]) -> tuple[list[Path], Array]:
    lines = list(read_lines(path, "a line for each image: seconds, or name and seconds"))
    rows = []
    for where, words in lines:
        try:
            rows.append((words[-2] if len(words) == 2 else "", float(words[-1])))
        except ValueError:
            raise DatasetError(
                f"{where}: found {' '.join(words)[:80]!r}, expected seconds"
            ) from None
    if all(name for name, _ in rows):
        by_name = {name: file for file in files for name in (file.name, file.stem, _stem(file))}
        known = [(by_name[name], stamp_s) for name, stamp_s in rows if name in by_name]
        if len(known) < max(len(files), len(rows)):
            logger.warning(
                "%s: found times of %d of the %d images; the others are left out",
                path,
                len(known),
                len(files),
            )
    elif len(rows) == len(files):
        known = [(file, stamp_s) for file, (_, stamp_s) in zip(files, rows, strict=True)]
    else:
        raise DatasetError(f"{path}: found {len(rows)} times, expected {len(files)} as images")
    if not known:
        raise DatasetError(f"{path}: found the time of no image, expected lines of name, seconds")
    stamps_s = as_seconds([stamp_s for _, stamp_s in known])
    check_stamps(stamps_s, path)
    return [file for file, _ in known], stamps_s


def _check_size(file: Path, size: tuple[int, int]) -> None:
    found = check_header(file) if _is_png(file) else _open_array(file).shape
    if found is not None and found != size:
        raise DatasetError(
            f"{file}: found {'x'.join(map(str, found[::-1]))} pixels, "
            f"expected {size[1]}x{size[0]} as {INTRINSICS} says"
        )


def _read_depth(file: Path, units_per_m: float | None) -> NDArray[Any]:
    array = read_depth_png(file) if _is_png(file) else np.array(_open_array(file))
    if array.dtype == np.uint16:
        return checked_depth(file, scale_depth(array, units_per_m or 1000.0))
    with np.errstate(over="ignore"):  # beyond float32: infinite, which is missing
        depth_m = (array.astype(np.float64) / (units_per_m or 1.0)).astype(np.float32)
    return checked_depth(file, depth_m)


def _open_array(file: Path) -> NDArray[Any]:
    """Map an array into memory: so far, only its header is read."""
    try:
        array = open_npy(file)
    except FileNotFoundError:
        raise DatasetError(f"{file}: found no such file, expected a depth image") from None
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise DatasetError(f"{file}: found no whole array ({reason}), expected depth") from error
    if array.ndim != 2 or not (array.dtype == np.uint16 or array.dtype.kind == "f"):
        raise DatasetError(
            f"{file}: found an array {array.shape} of {array.dtype}, "
            "expected (H, W) of uint16 or float"
        )
    return array


def _read_groundtruth(folder: Path, stamps_s: Array) -> Trajectory | None:
    for name in POSES:
        if (folder / name).is_file():
            return read_groundtruth(folder / name, stamps_s)
    return None
