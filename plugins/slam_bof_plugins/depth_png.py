"""16-bit depth images as PNG files: checked before they are decoded."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.core import open_bytes, read_bytes
from slam_bof.errors import DatasetError

__all__ = ["check_header", "decode_depth_png", "read_depth_png"]

SIGNATURE = b"\x89PNG\r\n\x1a\n"
HEADER_LENGTH = 33
GREY, PALETTE = 0, 3


def read_depth_png(path: Path) -> NDArray[np.uint16]:
    """Read an (H, W) uint16 image.

    Raises
    ------
    DatasetError
        If the file is missing, no PNG, of 8 bits, in colour, truncated or damaged.
    """
    return decode_depth_png(_read(path), path)


def decode_depth_png(data: bytes, where: Path | str) -> NDArray[np.uint16]:
    """Decode the bytes of an (H, W) uint16 image; a ``DatasetError`` begins with ``where``.

    Raises as ``read_depth_png``.
    """
    _header_size(where, data)
    # The chunks are checked first, because decoders handle truncated images differently.
    _check_chunks(where, data)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise DatasetError(f"{where}: found a PNG file that does not decode, expected depth")
    return np.asarray(image, dtype=np.uint16)


def check_header(path: Path, expected: tuple[int, int] | None = None) -> tuple[int, int] | None:
    """Check that the header is that of a 16-bit grey PNG; return (height, width).

    None means that the file is no PNG at all: reading it will say so. Nothing else of the file
    is read, so a whole sequence can be checked before it is begun.

    Raises
    ------
    DatasetError
        If the image is of 8 bits, in colour, or not of the ``expected`` (height, width).
    """
    try:
        with open_bytes(path) as file:
            size = _header_size(path, file.read(HEADER_LENGTH))
    except (OSError, NotAPng):
        return None
    if expected is not None and size != expected:
        raise DatasetError(
            f"{path}: found {size[1]}x{size[0]} pixels, expected {expected[1]}x{expected[0]} "
            "as in the frames before"
        )
    return size


class NotAPng(DatasetError):
    """The file does not begin as PNG files do."""


def _read(path: Path) -> bytes:
    if not os.path.isfile(path):
        raise DatasetError(f"{path}: found no such file, expected a depth image")
    try:
        return read_bytes(path)
    except OSError as error:
        raise DatasetError(f"{path}: depth image cannot be read: {error.strerror}") from error


def _header_size(where: Path | str, data: bytes) -> tuple[int, int]:
    if len(data) < HEADER_LENGTH or not data.startswith(SIGNATURE) or data[12:16] != b"IHDR":
        raise NotAPng(f"{where}: found no PNG file, expected a 16-bit grey PNG")
    width, height, bits, colour = struct.unpack(">IIBB", data[16:26])
    if colour != GREY:
        kind = "a palette" if colour == PALETTE else "colour"
        raise DatasetError(f"{where}: found a PNG in {kind}, expected depth: 16-bit grey")
    if bits != 16:
        raise DatasetError(f"{where}: found a PNG of {bits} bits, expected depth: 16-bit grey")
    return height, width


def _check_chunks(where: Path | str, data: bytes) -> None:
    """Walk the chunks (PNG specification, section 5) to the last one, checking their CRCs."""
    view = memoryview(data)
    at = len(SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        end = at + 12 + length
        if end > len(data):
            break
        (crc,) = struct.unpack_from(">I", data, end - 4)
        if crc != zlib.crc32(view[at + 4 : end - 4]):
            raise DatasetError(f"{where}: found a damaged PNG file, expected a whole one")
        if data[at + 4 : at + 8] == b"IEND":
            return
        at = end
    raise DatasetError(
        f"{where}: found a truncated PNG file of {len(data)} bytes, expected a whole one"
    )
