"""SUN RGB-D (Song et al., CVPR 2015): single depth images with scene labels, no sequence.

``ROOT/SUNRGBD/{kv1,kv2,realsense,xtion}/.../IMAGE/`` holds ``depth/*.png``, ``image/*.jpg``,
``intrinsics.txt`` (3x3) and ``scene.txt``; ``ROOT/SUNRGBDtoolbox/traintestSUNRGBD/allsplit.mat``
lists which images are for training (``alltrain``) and for testing (``alltest``). Give ``ROOT`` or
``ROOT/SUNRGBD``. Of a stored depth p, millimetres are ``(p >> 3) | (p << 13)`` in 16 bits, clipped
at 8 m, as in the toolbox's ``read3dPoints``.

The images are those of the 19 classes with more than 80 images each that the paper's scene
classification takes, training images first, each half in the order of ``allsplit.mat``. They have
no times: an image's index counts as its time in seconds.
"""

from __future__ import annotations

import json
import logging
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import ClassVar, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import read_text
from slam_bof.errors import DatasetError
from slam_bof.geometry import checked_intrinsics
from slam_bof.types import DepthFrame, Intrinsics, Params
from slam_bof_plugins.dataset_files import read_gray, read_rgb
from slam_bof_plugins.depth_png import check_header, read_depth_png

__all__ = ["SCENES", "SunRgbd", "SunRgbdParams"]

logger = logging.getLogger(__name__)

SENSORS = ("kv1", "kv2", "realsense", "xtion")
SPLIT = Path("SUNRGBDtoolbox", "traintestSUNRGBD", "allsplit.mat")
HALVES = ("alltrain", "alltest")
MAX_DEPTH_MM = 8000
TIMEOUT_S = 120.0

SCENES = (
    "bathroom", "bedroom", "classroom", "computer_room", "conference_room", "corridor",
    "dining_area", "dining_room", "discussion_area", "furniture_store", "home_office", "kitchen",
    "lab", "lecture_theatre", "library", "living_room", "office", "rest_space", "study_space",
)  # fmt: skip
"""The classes that have more than 80 images."""


class SunRgbdParams(Params):
    """The depth images and scenes to read."""

    depth: Literal["depth", "depth_bfx"] = Field(
        "depth",
        description="Depth images to read: depth as measured, or depth_bfx with its holes filled.",
    )
    all_scenes: bool = Field(
        False,
        description="Whether to take the images of all scenes, not only of the paper's 19 classes.",
    )


@dataclass(frozen=True, slots=True)
class Item:
    """One image: its folder, depth file, camera, label, and whether it is for training."""

    folder: Path
    depth: Path
    intrinsics: Intrinsics
    scene: str
    is_train: bool


class SunRgbd:
    """The labelled images of SUN RGB-D; ``frame(i).intrinsics`` differs from image to image.

    Attributes
    ----------
    is_train
        (N,) bool, for each image: whether the official split trains with it, else tests.
    """

    name: ClassVar[str] = "sunrgbd"
    Params = SunRgbdParams
    sequence = "SUNRGBD"

    def __init__(self, items: Sequence[Item]) -> None:
        self._items = tuple(items)
        self.intrinsics = self._items[0].intrinsics
        self.is_train: NDArray[np.bool_] = np.array([item.is_train for item in self._items])

    @classmethod
    def recognises(cls, path: Path) -> str:
        """Return the files that identify the format; empty if there are none."""
        images = _images_folder(path)
        if images is None:
            return ""
        sensors = "/, ".join(name for name in SENSORS if (images / name).is_dir())
        split = _split_file(images)
        return f"SUNRGBD with {sensors}/" + (f", {split.name}" if split.is_file() else "")

    @classmethod
    def open(cls, path: Path, params: SunRgbdParams | None = None) -> Self:
        """Open the collection; images that are listed but not there are left out with a warning.

        Raises
        ------
        DatasetError
            If the images or the split file are missing, or one of either is malformed.
        """
        params = params or SunRgbdParams()
        images = _images_folder(path)
        if images is None:
            raise DatasetError(
                f"{path}: found no SUNRGBD/ with {', '.join(SENSORS)}, expected SUN RGB-D"
            )
        listed = list(_read_split(_split_file(images), images))
        present = [(folder, is_train) for folder, is_train in listed if folder.is_dir()]
        if len(present) < len(listed):
            logger.warning(
                "%s: %d of the %d images of the split are not there; left out",
                images,
                len(listed) - len(present),
                len(listed),
            )
        items = []
        for folder, is_train in present:
            scene = _read_scene(folder / "scene.txt")
            if params.all_scenes or scene in SCENES:
                items.append(_item(folder, params.depth, scene, is_train))
        if not items:
            raise DatasetError(
                f"{images}: found none of the {len(listed)} images of the split with a scene of "
                "the 19, expected kv1/, kv2/, realsense/ and xtion/ as in SUNRGBD.zip"
            )
        return cls(items)

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self._items)

    def frame(self, index: int) -> DepthFrame:
        """Read an image: uint16 mm, with a camera of its own; its index counts as its time."""
        item = self._items[index]
        depth = _decode(read_depth_png(item.depth))
        return DepthFrame(float(range(len(self))[index]), depth, item.intrinsics)

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image, (H, W, 3), if it is of the depth image's size: registered."""
        item = self._items[index]
        rgb = read_rgb(_only(item.folder / "image", ".jpg"))
        size = (item.intrinsics.height, item.intrinsics.width)
        return rgb if rgb is not None and rgb.shape[:2] == size else None

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read the colour image in grey, (H, W)."""
        return read_gray(_only(self._items[index].folder / "image", ".jpg"))

    def groundtruth(self) -> None:
        """Return None: no poses."""

    def scenes(self) -> tuple[str, ...]:
        """Return the label of every image."""
        return tuple(item.scene for item in self._items)


def _images_folder(path: Path) -> Path | None:
    for folder in (path / "SUNRGBD", path):
        if any((folder / name).is_dir() for name in SENSORS) and (
            folder.resolve().name == "SUNRGBD" or _split_file(folder).is_file()
        ):
            return folder
    return None


def _split_file(images: Path) -> Path:
    beside = images.resolve().parent / SPLIT
    return images / SPLIT if (images / SPLIT).is_file() else beside


def _read_split(file: Path, images: Path) -> Iterator[tuple[Path, bool]]:
    """Yield the folder of each image of the split, and whether it is for training."""
    if not file.is_file():
        raise DatasetError(f"{file}: found no such file, expected the split of SUNRGBDtoolbox.zip")
    halves = _load_strings(file)
    for half in HALVES:
        for name in halves[half]:
            # As on the authors' machine: /n/fs/.../SUNRGBD/kv1/NYUdata/NYU0001
            parts = PurePosixPath(name).parts
            start = next((i for i, part in enumerate(parts) if part in SENSORS), None)
            if start is None or ".." in parts:
                raise DatasetError(
                    f"{file}: found {name[:80]!r}, expected a folder below {', '.join(SENSORS)}"
                )
            yield images.joinpath(*parts[start:]), half == "alltrain"


def _load_strings(file: Path) -> dict[str, list[str]]:
    """Return the texts of both halves, read by another process: a bad file may kill SciPy."""
    reader = Path(__file__).with_name("mat_strings.py")
    try:
        done = subprocess.run(
            [sys.executable, str(reader), str(file), *HALVES],
            capture_output=True,
            text=True,
            errors="replace",
            timeout=TIMEOUT_S,
            check=True,
        )
        halves: dict[str, list[str]] = json.loads(done.stdout)
    except subprocess.CalledProcessError as error:
        lines = error.stderr.strip().splitlines()
        found = lines[-1][:200] if lines else f"an error that ended its reader ({error.returncode})"
    except (subprocess.TimeoutExpired, OSError, ValueError) as error:
        found = f"{type(error).__name__}"
    else:
        return halves
    raise DatasetError(
        f"{file}: found {found}, expected a MATLAB 5 file with {' and '.join(HALVES)}"
    )


def _read_scene(file: Path) -> str:
    try:
        scene = read_text(file).strip()
    except (OSError, UnicodeDecodeError) as error:
        found = getattr(error, "strerror", None) or error
        raise DatasetError(f"{file}: found {found}, expected the name of a scene") from error
    if not scene or len(scene.split()) != 1:
        raise DatasetError(f"{file}: found {scene[:40]!r}, expected one word: a scene")
    return scene


def _item(folder: Path, depth_folder: str, scene: str, is_train: bool) -> Item:
    depth = _only(folder / depth_folder, ".png")
    if depth is None:
        raise DatasetError(f"{folder / depth_folder}: found no .png file, expected a depth image")
    size = check_header(depth)
    if size is None:
        raise DatasetError(f"{depth}: found no PNG file, expected a 16-bit grey PNG")
    return Item(folder, depth, _read_camera(folder / "intrinsics.txt", size), scene, is_train)


def _only(folder: Path, suffix: str) -> Path | None:
    """Return the first file of that kind; there is one in each such folder."""
    return min(folder.glob(f"*{suffix}"), default=None)


def _read_camera(file: Path, size: tuple[int, int]) -> Intrinsics:
    try:
        K = np.array([float(word) for word in read_text(file).split()])
    except (OSError, ValueError) as error:
        found = getattr(error, "strerror", None) or error
        raise DatasetError(f"{file}: found {found}, expected 9 numbers: intrinsics") from error
    if K.shape != (9,):
        raise DatasetError(f"{file}: found {K.tolist()}, expected 9 numbers: fx 0 cx 0 fy cy 0 0 1")
    height, width = size
    return checked_intrinsics(file, width, height, *K[[0, 4, 2, 5]].tolist())


def _decode(stored: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return millimetres: the three low bits were stored above the others."""
    rotated = (stored >> np.uint16(3)) | (stored << np.uint16(13))
    return np.minimum(rotated, np.uint16(MAX_DEPTH_MM))
