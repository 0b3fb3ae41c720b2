"""Images from anywhere: no memory is reserved that their bytes cannot fill."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["decode_image"]

PNG, JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"
MAX_IMAGE_PIXELS = 1 << 26
"""A colour image of that many pixels takes 200 MB; cameras have up to some 50 million."""
FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
START_OF_SCAN = 0xDA
NO_SEGMENTS = frozenset({0x00, 0x01, 0xFF, *range(0xD0, 0xDA)})
"""Markers of JPEG: those of a frame, and those that no segment follows."""


def decode_image(data: bytes, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any] | None:
    """Return the image in the bytes of a file, in any format that OpenCV reads; None if it is none.

    OpenCV believes headers: twenty bytes may stand for gigabytes. So the number of pixels and the
    lengths of chunks are checked first, in PNG and JPEG files.
    """
    sizes = _png_sizes if data.startswith(PNG) else _jpeg_sizes
    try:
        is_moderate = all(0 < width * height <= MAX_IMAGE_PIXELS for width, height in sizes(data))
        if not data or not is_moderate:
            return None
        return cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except (struct.error, cv2.error):
        return None


def _png_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of a PNG file; (0, 0) for a chunk that is longer than the file."""
    at = len(PNG)
    yield struct.unpack_from(">2I", data, at + 8)
    while at + 8 <= len(data) and data[at + 4 : at + 8] != b"IEND":
        at += 12 + int(struct.unpack_from(">I", data, at)[0])
        if at > len(data):
            yield 0, 0


def _jpeg_sizes(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield the width and height of a JPEG file; nothing for other formats.

    Segments are followed as libjpeg does, which skips what lies between them.
    """
    at = len(JPEG) if data.startswith(JPEG) else len(data)
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
