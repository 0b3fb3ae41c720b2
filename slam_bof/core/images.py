"""Images of unknown origin: their sizes are checked before memory is reserved."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["decode_image"]

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
TIFF = {b"II*\0": "<", b"MM\0*": ">"}
"""Byte order by the first bytes."""
MAX_IMAGE_PIXELS = 1 << 26
"""A colour image of that many pixels takes 200 MB; cameras have up to some 50 million."""
TIFF_SIZES = (256, 257, 322, 323)
"""Tags of TIFF: width and height of the image, and of its tiles."""
TIFF_NUMBERS = {3: "H", 4: "I"}
"""Types of TIFF that sizes may be of."""
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
START_OF_SCAN = 0xDA
NO_SEGMENTS = frozenset({0x00, 0x01, 0xFF, *range(0xD0, 0xDA)})
"""Markers of JPEG: those of a frame, and those that no segment follows."""


def decode_image(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Return the image in the bytes of a PNG, JPEG or TIFF file; None if it is none.

    OpenCV believes headers: twenty bytes may stand for gigabytes. So the number of pixels and the
    lengths of chunks are checked first, and formats that are not checked are not read.
    """
    try:
        if any(not 0 < width * height <= MAX_IMAGE_PIXELS for width, height in _sizes(data)):
            return None
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except (struct.error, cv2.error):
        return None


def _sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Return every width and height that a file says, or (0, 0) if it cannot be read."""
    if data.startswith(PNG):
        return _png_sizes(data)
    if data.startswith(JPEG):
        return _jpeg_sizes(data)
    return _tiff_sizes(data) if data[:4] in TIFF else iter([(0, 0)])


def _png_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of a PNG file; (0, 0) for a chunk that is longer than the file."""
    at = len(PNG)
    yield struct.unpack_from(">2I", data, at + 8)
    while at + 8 <= len(data) and data[at + 4 : at + 8] != b"IEND":
        at += 12 + int(struct.unpack_from(">I", data, at)[0])
        if at > len(data):
            yield 0, 0


def _jpeg_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of a JPEG file.

    Segments are followed as libjpeg does, which skips what lies between them.
    """
    at = len(JPEG)
    while 0 <= (at := data.find(b"\xff", at)) < len(data) - 9:
        marker = data[at + 1]
        if marker == START_OF_SCAN:
            return
        if marker in NO_SEGMENTS:
            at += 1 + (marker != 0xFF)
            continue
        length, _, height, width = struct.unpack_from(">HBHH", data, at + 2)
        if marker in FRAMES:
            yield width, height
        at += 2 + length


def _tiff_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of the first image of a TIFF file, and of its tiles."""
    order = TIFF[data[:4]]
    (at,) = struct.unpack_from(order + "I", data, 4)
    (n_entries,) = struct.unpack_from(order + "H", data, at)
    largest = dict.fromkeys(TIFF_SIZES, 0)
    for entry in range(at + 2, at + 2 + 12 * n_entries, 12):
        tag, kind, count = struct.unpack_from(order + "2HI", data, entry)
        if tag in largest:
            if kind not in TIFF_NUMBERS or count != 1:
                yield 0, 0
                return
            (size,) = struct.unpack_from(order + TIFF_NUMBERS[kind], data, entry + 8)
            largest[tag] = max(largest[tag], size)
    width, height, tile_width, tile_height = largest.values()
    yield width, height
    yield tile_width or 1, tile_height or 1
