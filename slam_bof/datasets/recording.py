"""Write depth images into the ``folder`` layout as they come, so that each one is there at once."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import RunError
from slam_bof.types import Intrinsics

__all__ = ["CameraFrame", "DepthCamera", "FolderWriter", "RecordResult", "record"]

FAST_PNG = [cv2.IMWRITE_PNG_COMPRESSION, 1]


@dataclass(frozen=True, slots=True, eq=False)
class CameraFrame:
    """What a camera gives: time in seconds, depth (H, W) uint16 in its units, colour (H, W, 3).

    ``number`` counts the frames that the camera took; colour is RGB, registered to depth, or None.
    """

    stamp_s: float
    number: int
    depth: NDArray[np.uint16]
    color: NDArray[np.uint8] | None = None


class DepthCamera(Protocol):
    """A camera that is on."""

    intrinsics: Intrinsics
    units_per_m: float
    """How many units of depth are a metre."""
    fps: float

    def read(self) -> CameraFrame:
        """Wait for the next frame; ``DatasetError`` if none comes."""


class FolderWriter:
    """Writes one recording: a new folder with ``intrinsics.json``, ``depth/`` and ``color/``.

    An image is named by its time in seconds, and gets that name only when it is whole: a recording
    that is killed is a recording of what came before. Nothing is in memory but the frame in hand.

    Raises
    ------
    RunError
        If the folder has files already, or cannot be written.
    """

    def __init__(self, folder: Path, camera: DepthCamera) -> None:
        self._folder = folder
        if folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
            raise RunError(f"{folder}: found something there already, expected a new folder")
        about = {
            **asdict(camera.intrinsics),
            "depth_scale": camera.units_per_m,
            "fps": camera.fps,
        }
        try:
            (folder / "depth").mkdir(parents=True)
            self._put(folder / "intrinsics.json", (json.dumps(about, indent=2) + "\n").encode())
        except OSError as error:
            raise RunError(f"{folder}: cannot write the recording: {error.strerror}") from error

    def write(self, frame: CameraFrame) -> None:
        """Write a frame; ``RunError`` if the disk is full."""
        name = f"{frame.stamp_s:.6f}"
        try:
            # Colour first: where there is a depth image, all of its frame is there.
            if frame.color is not None:
                (self._folder / "color").mkdir(exist_ok=True)
                bgr = cv2.cvtColor(frame.color, cv2.COLOR_RGB2BGR)
                self._put(self._folder / "color" / f"{name}.jpg", _encode(".jpg", bgr, []))
            png = _encode(".png", frame.depth, FAST_PNG)
            self._put(self._folder / "depth" / f"{name}.png", png)
        except OSError as error:
            raise RunError(
                f"{self._folder}: cannot write frame {name}: {error.strerror}"
            ) from error

    @staticmethod
    def _put(path: Path, data: bytes) -> None:
        trial = path.with_name(f".{path.name}")
        trial.write_bytes(data)
        trial.replace(path)


@dataclass(slots=True)
class RecordResult:
    """Numbers of frames that were written, and of those in between that were not."""

    n_frames: int = 0
    n_dropped: int = 0


def record(
    camera: DepthCamera,
    writer: FolderWriter,
    *,
    n_frames: int | None = None,
    duration_s: float | None = None,
    on_frame: Callable[[RecordResult], None] = lambda result: None,
) -> RecordResult:
    """Write frames until there are ``n_frames``, ``duration_s`` is over, or Ctrl-C is pressed.

    A frame that is not later than the one before is dropped: cameras repeat them at times.
    """
    result = RecordResult()
    last_number: int | None = None
    last_us = -1
    started_s = time.monotonic()
    try:
        while n_frames is None or result.n_frames < n_frames:
            if duration_s is not None and time.monotonic() - started_s >= duration_s:
                break
            frame = camera.read()
            if last_number is not None:
                result.n_dropped += max(frame.number - last_number - 1, 0)
            last_number = frame.number
            stamp_us = round(frame.stamp_s * 1e6)  # to which images are named
            if stamp_us <= last_us:
                continue
            last_us = stamp_us
            writer.write(frame)
            result.n_frames += 1
            on_frame(result)
    except KeyboardInterrupt:
        pass  # the usual way to end a recording of no given length
    return result


def _encode(suffix: str, image: NDArray[Any], options: list[int]) -> bytes:
    coded, data = cv2.imencode(suffix, image, options)
    if not coded:
        raise OSError(None, f"image could not be coded as {suffix}")
    return bytes(data.tobytes())
