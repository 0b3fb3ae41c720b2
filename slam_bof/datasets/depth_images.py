"""Single depth images: files read by themselves, with the camera that took them."""

from __future__ import annotations

import itertools
import json
import os
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import decode_image, open_npy, read_bytes, read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_depth, checked_intrinsics
from slam_bof.types import MAX_PIXELS, DepthFrame, Intrinsics

__all__ = ["CAMERA_FILE", "DepthImages", "is_image", "read_depth_image"]

SUFFIXES = (".png", ".tif", ".tiff", ".npy", ".jpg", ".jpeg")
"""Suffixes of image files. Images of 8 bits need a camera file that gives ``depth_scale``."""
KINECT_FOCAL_PX = 585.0
"""Focal length of the 7-Scenes depth camera, for an image 640 pixels wide."""
CAMERA_FILE = "intrinsics.json"
MILLIMETRES = 1000.0
ENDLESS = (RecursionError, OverflowError)
"""What the parser raises for JSON that is nested too deep or has numbers that are too large."""
FRAMES_PER_S = 30.0
MIN_REACH_M = 1.0
"""Least depth that the largest value of 8 bits has to stand for, or the image is no depth of rooms:
grey values in millimetres reach 0.255 m."""


def is_image(path: Path) -> bool:
    """Return whether a file is an image, judged by its name."""
    return path.suffix.lower() in SUFFIXES


def read_depth_image(
    path: Path,
    *,
    intrinsics: Intrinsics | Sequence[float] | None = None,
    depth_scale: float | None = None,
    camera_file: Path | None = None,
    stamp_s: float = 0.0,
) -> tuple[DepthFrame, str]:
    """Read a depth image (16-bit PNG or TIFF, or .npy of uint16 or float).

    An image of 8 bits is read where its camera file says ``depth_scale``.

    Parameters
    ----------
    path
        The file.
    intrinsics
        fx, fy, cx, cy in pixels, or a camera, whose images have that size. By default those of the
        camera file, or else a Kinect's, scaled to the image's width.
    depth_scale
        Units a metre; by default that of the camera file, or else 1000, and 1 for floats.
    camera_file
        JSON with width, height, fx, fy, cx, cy in pixels and, if need be, ``depth_scale`` (units a
        metre) and ``depth_offset`` (units added before scaling). By default ``intrinsics.json``
        beside the image, where there is one.
    stamp_s
        Time stamp of the frame, in seconds.

    Returns
    -------
    frame : DepthFrame
        The image.
    source : str
        The source of the intrinsics, in words.

    Raises
    ------
    DatasetError
        If the file is no depth image, or ``intrinsics.json`` is not of this image.
    """
    depth = _read(path)
    height, width = depth.shape
    beside = path.parent / CAMERA_FILE
    if camera_file is None and beside.is_file():
        camera_file = beside
    offset = 0.0
    if camera_file is not None:
        camera, scale, offset = _read_camera(camera_file, width, height)
        depth_scale, source = depth_scale or scale, f"from {camera_file}"
    if isinstance(intrinsics, Intrinsics):
        camera, source = intrinsics, "as given"
        if (camera.width, camera.height) != (width, height):
            raise DatasetError(
                f"{path}: found {width}x{height} pixels, expected {camera.width}x{camera.height} "
                "as the images of the given camera"
            )
    elif intrinsics is not None:
        fx, fy, cx, cy = intrinsics
        camera = checked_intrinsics(f"--intrinsics for {path}", width, height, fx, fy, cx, cy)
        source = "as given"
    elif camera_file is None:
        focal_px = KINECT_FOCAL_PX * width / 640.0
        camera = Intrinsics(width, height, focal_px, focal_px, width / 2, height / 2)
        source = f"assumed, a Kinect's; found no {CAMERA_FILE} beside the image"
    if depth.dtype == np.uint8:
        if depth_scale is None:
            raise DatasetError(
                f"{path}: found an image of 8 bits, expected 16 bits, or a camera file with "
                "depth_scale, the units a metre"
            )
        reach_m = (255.0 + offset) / depth_scale
        if reach_m < MIN_REACH_M:
            raise DatasetError(
                f"{path}: found an image of 8 bits, which reaches {reach_m:.3g} m with depth_scale "
                f"{depth_scale:g}, expected 16 bits, or the depth_scale of 8 bits"
            )
        depth = np.where(depth == 0, 0.0, depth + np.float32(offset)).astype(np.float32)
        depth = checked_depth(path, depth / np.float32(depth_scale))
        return DepthFrame(stamp_s, depth, camera), source
    is_float = depth.dtype.kind == "f"
    scale = depth_scale or (1.0 if is_float else MILLIMETRES)
    if is_float or scale != MILLIMETRES:
        missing = depth == np.iinfo(np.uint16).max if not is_float else ~np.isfinite(depth)
        with np.errstate(over="ignore"):  # of float64 beyond float32: infinite, missing
            depth = np.where(missing, 0.0, depth / scale).astype(np.float32)
        depth = checked_depth(path, depth)
    return DepthFrame(stamp_s, depth, camera), source


class DepthImages:
    """Depth images in the order given, as a data set without colour, poses or labels.

    An image's time is the number that its name ends with, at 30 Hz; where these do not grow, its
    place in the list.
    """

    name: ClassVar[str] = "images"

    def __init__(self, files: Sequence[Path], camera_file: Path | None = None) -> None:
        self._files = tuple(files)
        self._camera_file = camera_file
        self.sequence = files[0].parent.resolve().name
        numbers = [re.search(r"(\d{1,12})\D*$", file.stem) for file in files]
        values = [int(number[1]) if number else 0 for number in numbers]
        grow = all(a < b for a, b in itertools.pairwise(values))
        self._stamps_s = np.array(values if grow else range(len(files))) / FRAMES_PER_S
        self.intrinsics = self.frame(0).intrinsics

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self._files)

    def frame(self, index: int) -> DepthFrame:
        """Read an image."""
        stamp_s = float(self._stamps_s[index])
        return read_depth_image(self._files[index], camera_file=self._camera_file, stamp_s=stamp_s)[
            0
        ]

    def color(self, index: int) -> None:
        """Return None: no colour."""

    def gray(self, index: int) -> None:
        """Return None: no colour."""

    def groundtruth(self) -> None:
        """Return None: no poses."""

    def scenes(self) -> None:
        """Return None: no labels."""


def _read(path: Path) -> NDArray[Any]:
    if not os.path.isfile(path):  # is_file raises for long names
        raise DatasetError(f"{str(path)[-200:]}: found no such file, expected a depth image")
    if path.suffix.lower() == ".npy":
        try:
            image = np.asarray(open_npy(path))
        except (OSError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise DatasetError(f"{path}: found no array ({reason}), expected depth") from error
    else:
        read = decode_image(read_bytes(path))
        if read is None:
            raise DatasetError(f"{path}: found no image that can be read, expected 16-bit depth")
        image = read
    is_depth = image.dtype in (np.uint8, np.uint16) or image.dtype.kind == "f"
    if not is_depth or image.ndim != 2 or image.size > MAX_PIXELS:
        shape = "x".join(map(str, image.shape))
        raise DatasetError(
            f"{path}: found an image {shape} of {image.dtype}, expected one channel of uint16, "
            f"or of floats in metres, and at most {MAX_PIXELS} pixels"
        )
    return image


def _read_camera(file: Path, width: int, height: int) -> tuple[Intrinsics, float | None, float]:
    """Return the camera, the units a metre if given, and the units to add before scaling."""
    try:
        found = json.loads(read_text(file))
        size = int(found["width"]), int(found["height"])
        fx, fy, cx, cy = (float(found[name]) for name in ("fx", "fy", "cx", "cy"))
        scale = found.get("depth_scale")
        scale = None if scale is None else float(scale)
        offset = float(found.get("depth_offset", 0.0))
        if scale is not None and not 0 < scale < np.inf:
            raise ValueError("depth_scale is not positive")
        if not np.isfinite(offset):
            raise ValueError("depth_offset is not finite")
    except (OSError, ValueError, TypeError, KeyError, AttributeError, *ENDLESS) as error:
        raise DatasetError(
            f"{file}: found {repr(error)[:200]}, expected JSON with width, height, fx, fy, cx, cy"
        ) from error
    if size != (width, height):
        raise DatasetError(
            f"{file}: found {size[0]}x{size[1]} pixels, expected {width}x{height} as the image"
        )
    return checked_intrinsics(file, width, height, fx, fy, cx, cy), scale, offset
