"""The scene of a single depth image, by itself."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import DatasetError, ModelError
from slam_bof.model import Model
from slam_bof.scene_filter import decide
from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["ImageLabel", "label_image"]

KINECT_FOCAL_PX = 585.0
"""Of an image 640 pixels wide, the 7-Scenes depth camera's."""
CAMERA_FILE = "intrinsics.json"
MILLIMETRES = 1000.0


@dataclass(frozen=True, slots=True)
class ImageLabel:
    """What a model says of a depth image; ``probabilities`` by label, most likely first.

    ``label`` is "unknown" where the most likely one is less probable than was asked for.
    ``intrinsics_from`` says in words where the intrinsics are from.
    """

    image: str
    label: str
    probability: float
    probabilities: dict[str, float]
    intrinsics: Intrinsics
    intrinsics_from: str


def label_image(
    path: Path,
    model: Model,
    *,
    intrinsics: Sequence[float] | None = None,
    depth_scale: float | None = None,
    min_probability: float = 0.0,
) -> ImageLabel:
    """Label a depth image file (16-bit PNG or TIFF, or .npy of uint16 or float).

    Parameters
    ----------
    path
        The file.
    model
        Trained with labels.
    intrinsics
        fx, fy, cx, cy in pixels. By default those of ``intrinsics.json`` beside the image (width,
        height, fx, fy, cx, cy; depth_scale), or else a Kinect's, scaled to the image's width.
    depth_scale
        Units a metre; by default as that file has it, or else 1000, and 1 for floats.
    min_probability
        Below it the label is "unknown".

    Raises
    ------
    DatasetError
        If the file is no depth image, or ``intrinsics.json`` is not of this image.
    ModelError
        If the model was trained without labels.
    """
    labeller = model.labeller()
    if labeller is None:
        raise ModelError(f"the model ({model.trained_on}): found no labels, expected some")
    depth = _read(path)
    height, width = depth.shape
    camera_file = path.parent / CAMERA_FILE
    if intrinsics is not None:
        camera, source = Intrinsics(width, height, *intrinsics), "as given"
    elif camera_file.is_file():
        camera, scale = _read_camera(camera_file, width, height)
        depth_scale, source = depth_scale or scale, f"from {camera_file}"
    else:
        focal_px = KINECT_FOCAL_PX * width / 640.0
        camera = Intrinsics(width, height, focal_px, focal_px, width / 2, height / 2)
        source = f"assumed, a Kinect's; found no {CAMERA_FILE} beside the image"
    is_float = depth.dtype.kind == "f"
    scale = depth_scale or (1.0 if is_float else MILLIMETRES)
    if is_float or scale != MILLIMETRES:
        depth = (depth.astype(np.float64) / scale).astype(np.float32)
    scene = labeller.label(DepthFrame(0.0, depth, camera))
    decided = decide(scene.probabilities, scene.classes, min_probability)
    pairs = zip(scene.classes, scene.probabilities.tolist(), strict=True)
    return ImageLabel(
        str(path),
        decided.label,
        decided.probability,
        dict(sorted(pairs, key=lambda pair: -pair[1])),
        camera,
        source,
    )


def _read(path: Path) -> NDArray[Any]:
    if not path.is_file():
        raise DatasetError(f"{path}: found no such file, expected a depth image")
    if path.suffix.lower() == ".npy":
        try:
            image = np.asarray(np.load(path, allow_pickle=False))
        except (OSError, ValueError, EOFError) as error:
            raise DatasetError(f"{path}: found no array ({error}), expected depth") from error
    else:
        read = cv2.imdecode(np.fromfile(path, np.uint8), cv2.IMREAD_UNCHANGED)
        if read is None:
            raise DatasetError(f"{path}: found no image that can be read, expected 16-bit depth")
        image = np.asarray(read)
    if image.ndim != 2 or not (image.dtype == np.uint16 or image.dtype.kind == "f"):
        shape = "x".join(map(str, image.shape))
        raise DatasetError(
            f"{path}: found an image {shape} of {image.dtype}, expected one channel of uint16, "
            "or of floats in metres"
        )
    return image


def _read_camera(file: Path, width: int, height: int) -> tuple[Intrinsics, float | None]:
    try:
        found = json.loads(file.read_text(encoding="utf-8"))
        size = int(found["width"]), int(found["height"])
        focal = [float(found[name]) for name in ("fx", "fy", "cx", "cy")]
        scale = found.get("depth_scale")
        scale = None if scale is None else float(scale)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise DatasetError(
            f"{file}: found {error!r}, expected JSON with width, height, fx, fy, cx, cy"
        ) from error
    if size != (width, height):
        raise DatasetError(
            f"{file}: found {size[0]}x{size[1]} pixels, expected {width}x{height} as the image"
        )
    return Intrinsics(width, height, *focal), scale
