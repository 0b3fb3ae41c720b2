"""What the readers of ``scripts/fuzz`` share: how a case is made, and checks of what was read."""

from __future__ import annotations

import dataclasses
import math
import random
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from slam_bof.errors import SlamBofError
from slam_bof.testing import example_frames
from slam_bof.types import DepthFrame, Intrinsics

__all__ = [
    "Reader",
    "expect",
    "expect_frame",
    "expect_numbers",
    "expect_poses",
    "nothing",
    "quiet",
    "turn",
    "write_image",
]

MAX_DEPTH_M = 1000.0
MAX_POSITION_M = 1e9


@dataclass(frozen=True)
class Reader:
    """What to prepare in a folder, how to make a case of it in another, and how to read that."""

    weight: float
    """Its share of the cases; slow ones get few."""
    prepare: Callable[[Path], None]
    mutate: Callable[[Path, Path, random.Random], None]
    read: Callable[[Path, Path], None]


@cache
def turn() -> tuple[list[DepthFrame], Any]:
    """Return a few small frames, rendered once."""
    frames, poses = example_frames(24)
    return [shrink(frame) for frame in frames], poses


def shrink(frame: DepthFrame) -> DepthFrame:
    """Return a frame of a quarter of the size."""
    camera, depth = frame.intrinsics, frame.depth[::4, ::4].copy()
    small = Intrinsics(depth.shape[1], depth.shape[0], *(
        value / 4 for value in (camera.fx, camera.fy, camera.cx, camera.cy)
    ))  # fmt: skip
    return DepthFrame(frame.stamp_s, depth, small)


def expect(holds: bool, what: str) -> None:
    """Raise ``AssertionError`` unless a value is plausible."""
    if not holds:
        raise AssertionError(what)


def expect_numbers(value: Any, what: str) -> None:
    """Check that all numbers in a value are finite and moderate."""
    if isinstance(value, dict):
        for key, item in value.items():
            expect_numbers(item, f"{what}.{key}")
    elif isinstance(value, list | tuple):
        for item in value:
            expect_numbers(item, what)
    elif dataclasses.is_dataclass(value):
        for field in dataclasses.fields(value):
            expect_numbers(getattr(value, field.name), f"{what}.{field.name}")
    elif isinstance(value, float):
        expect(math.isfinite(value) and abs(value) < 1e19, f"{what} is {value}")
    elif isinstance(value, np.ndarray) and value.dtype.kind == "f":
        expect(bool(np.isfinite(value).all()), f"{what} is not finite")


def expect_frame(frame: DepthFrame) -> None:
    """Check that a frame is one: its depth is within 1 km."""
    depth_m = frame.depth_m()
    expect(bool(np.isfinite(depth_m).all() and depth_m.max() <= MAX_DEPTH_M), "depth")
    expect(math.isfinite(frame.stamp_s), "stamp_s")


def expect_poses(poses: Any) -> None:
    """Check that those poses (N, 4, 4) that are known are not far away."""
    known = poses[np.isfinite(poses).all(axis=(1, 2))]
    expect(bool((np.abs(known[:, :3, 3]) < MAX_POSITION_M).all()), "a pose far away")


def nothing(place: Path) -> None:
    """Prepare nothing."""


def quiet(attempt: Callable[[], Any]) -> Any:
    """Return the result, None after an error in one line."""
    try:
        return attempt()
    except SlamBofError:
        return None


def write_image(path: Path, frame: DepthFrame) -> None:
    """Write a depth image in millimetres."""
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.rint(1000 * frame.depth_m()).astype(np.uint16))
