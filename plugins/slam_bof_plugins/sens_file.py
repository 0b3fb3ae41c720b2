"""ScanNet's .sens files, version 4: a camera and compressed frames, found by an index of offsets.

Little endian: uint32 version; uint64 length and the sensor's name; four 4x4 float32 matrices
(intrinsic and extrinsic of colour, then of depth); int32 compression of colour and of depth;
uint32 width and height of colour and of depth; float32 units of depth a metre; uint64 number of
frames. A frame: 4x4 float32 T_world_camera; uint64 times of colour and depth in microseconds;
uint64 sizes of both; their bytes. (github.com/ScanNet/ScanNet, SensReader.)
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import open_bytes
from slam_bof.errors import DatasetError
from slam_bof.types import MAX_PIXELS, Array

__all__ = ["SensFile", "is_sens", "open_sens"]

VERSION = 4
LONGEST_NAME = 1024
MAX_UNITS_PER_M = 1e6
FIXED = struct.Struct("<64f2i4IfQ")
FRAME = struct.Struct("<16f4Q")
COLOR_CODINGS = {-1: "unknown", 0: "raw", 1: "png", 2: "jpeg"}
DEPTH_CODINGS = {-1: "unknown", 0: "raw_ushort", 1: "zlib_ushort", 2: "occi_ushort"}


@dataclass(frozen=True, slots=True, eq=False)
class SensFile:
    """Where everything in a .sens file is: its header, and for each of N frames its place.

    ``K_color`` and ``K_depth`` are (4, 4) intrinsic matrices, ``color_size`` and ``depth_size``
    (height, width), ``poses`` (N, 4, 4) T_world_camera as they stand there, ``stamps_us`` (N,)
    the times of depth, ``places`` (N, 3) the offset of colour and the sizes of colour and depth.
    """

    path: Path
    K_color: Array
    K_depth: Array
    color_coding: str
    depth_coding: str
    color_size: tuple[int, int]
    depth_size: tuple[int, int]
    units_per_m: float
    poses: Array
    stamps_us: NDArray[np.uint64]
    places: NDArray[np.int64]

    def read_depth(self, index: int) -> NDArray[np.uint16]:
        """Read the depth of a frame, (H, W) in units of the file; ``DatasetError`` if damaged."""
        at, color, depth = self.places[index].tolist()
        data = self._read(at + color, depth)
        n_bytes = 2 * self.depth_size[0] * self.depth_size[1]
        if self.depth_coding == "zlib_ushort":
            try:
                # Read at most one byte more than expected, to be safe from decompression bombs.
                data = zlib.decompressobj().decompress(data, n_bytes + 1)
            except zlib.error as error:
                raise DatasetError(
                    f"{self.path}: frame {index}: found depth that does not unpack ({error}), "
                    "expected zlib"
                ) from error
        if len(data) != n_bytes:
            raise DatasetError(
                f"{self.path}: frame {index}: found {len(data)} bytes of depth, "
                f"expected {n_bytes}: {self.depth_size[1]}x{self.depth_size[0]} pixels"
            )
        return np.frombuffer(data, "<u2").astype(np.uint16).reshape(self.depth_size)

    def read_color(self, index: int) -> bytes:
        """Read the encoded colour image of a frame; empty if there is none."""
        at, color, _ = self.places[index].tolist()
        return self._read(at, color)

    def _read(self, at: int, n_bytes: int) -> bytes:
        try:
            with open_bytes(self.path) as file:
                file.seek(at)
                return file.read(n_bytes)
        except OSError as error:
            raise DatasetError(f"{self.path}: cannot be read: {error.strerror}") from error


def is_sens(path: Path) -> bool:
    """Return whether a file begins as .sens files of version 4 do."""
    try:
        with open_bytes(path) as file:
            head = file.read(12)
    except OSError:
        return False
    if len(head) < 12:
        return False
    version, length = struct.unpack("<IQ", head)
    return bool(version == VERSION and length <= LONGEST_NAME)


def open_sens(path: Path) -> SensFile:
    """Read the header of a .sens file and find its frames; no image is read.

    Raises
    ------
    DatasetError
        If it is no .sens file of version 4, ends before its last frame, or has depth in a coding
        that cannot be read.
    """
    try:
        size = path.stat().st_size
        with open_bytes(path) as file:
            return _index(path, file, size)
    except FileNotFoundError:
        raise DatasetError(f"{path}: found nothing, expected a .sens file") from None
    except OSError as error:
        raise DatasetError(f"{path}: cannot be read: {error.strerror}") from error


def _index(path: Path, file: BinaryIO, size: int) -> SensFile:
    header = _read_header(path, file)
    matrices = np.array(header[:64], dtype=np.float64).reshape(4, 4, 4)
    color_coding, depth_coding, cw, ch, dw, dh, units_per_m, n_frames = header[64:]
    # Checked before anything is reserved for them: the number may be nonsense.
    if n_frames * FRAME.size > size:
        raise DatasetError(f"{path}: found {size} bytes, expected {n_frames} frames: truncated")
    poses, stamps_us, places = _find_frames(path, file, size, n_frames)
    return SensFile(
        path=path,
        K_color=matrices[0],
        K_depth=matrices[2],
        color_coding=COLOR_CODINGS.get(color_coding, str(color_coding)),
        depth_coding=DEPTH_CODINGS[depth_coding],
        color_size=(ch, cw),
        depth_size=(dh, dw),
        units_per_m=units_per_m,
        poses=poses,
        stamps_us=stamps_us,
        places=places,
    )


def _read_header(path: Path, file: BinaryIO) -> tuple[Any, ...]:
    """Read the values of ``FIXED`` behind version and name, and check those of depth."""
    version, length = _unpack(path, file, struct.Struct("<IQ"), "the header")
    if version != VERSION:
        raise DatasetError(f"{path}: found version {version}, expected a .sens file of version 4")
    if length > LONGEST_NAME:
        raise DatasetError(f"{path}: found a name of {length} bytes, expected a .sens file")
    file.seek(length, 1)
    header = _unpack(path, file, FIXED, "the header")
    _, depth_coding, _, _, width, height, units_per_m, _ = header[64:]
    if DEPTH_CODINGS.get(depth_coding) not in ("raw_ushort", "zlib_ushort"):
        found = DEPTH_CODINGS.get(depth_coding, depth_coding)
        raise DatasetError(
            f"{path}: found depth coded as {found}, expected zlib_ushort or raw_ushort"
        )
    if not (0 < width * height <= MAX_PIXELS and 1.0 <= units_per_m <= MAX_UNITS_PER_M):
        raise DatasetError(
            f"{path}: found depth of {width}x{height} pixels and {units_per_m} units a metre, "
            f"expected at most {MAX_PIXELS} pixels and 1 to {MAX_UNITS_PER_M:g} units"
        )
    return header


def _find_frames(
    path: Path, file: BinaryIO, size: int, n_frames: int
) -> tuple[Array, NDArray[np.uint64], NDArray[np.int64]]:
    """Return the poses, times and places of all frames, without reading their images."""
    poses = np.empty((n_frames, 4, 4))
    stamps_us = np.empty(n_frames, np.uint64)
    places = np.empty((n_frames, 3), np.int64)
    for index in range(n_frames):
        *pose, _, stamp_us, color, depth = _unpack(path, file, FRAME, f"frame {index}")
        at = file.tell()
        if at + color + depth > size:
            raise DatasetError(
                f"{path}: found {size} bytes, which end in frame {index}, "
                f"expected {n_frames} frames: truncated"
            )
        poses[index] = np.reshape(pose, (4, 4))
        stamps_us[index] = stamp_us
        places[index] = at, color, depth
        file.seek(color + depth, 1)
    return poses, stamps_us, places


def _unpack(path: Path, file: BinaryIO, what: struct.Struct, where: str) -> tuple[Any, ...]:
    data = file.read(what.size)
    if len(data) < what.size:
        raise DatasetError(
            f"{path}: found the end of the file in {where}, expected more: truncated"
        )
    return what.unpack(data)
