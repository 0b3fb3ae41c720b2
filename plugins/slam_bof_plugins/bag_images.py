"""Depth images as ROS messages carry them: sensor_msgs Image and CompressedImage.

Raw: 16UC1 (mono16) in millimetres and 32FC1 in metres (REP 118), of either byte order, rows of
``step`` bytes. Compressed: a 16-bit PNG; or ``compressedDepth``, which puts 12 bytes (format and
two float32 of a quantisation) before a PNG or before RVL (Wilson 2017), and has 32FC1 quantised
as inverse depth: ``depth_m = a / (value - b)``.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import DatasetError
from slam_bof_plugins.depth_png import decode_depth_png

__all__ = ["COMPRESSED", "IMAGE", "decode_depth", "encoding"]

IMAGE = "sensor_msgs/msg/Image"
COMPRESSED = "sensor_msgs/msg/CompressedImage"

DTYPES = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
TRANSPORT = "compressedDepth"
CONFIG = struct.Struct("<i2f")
RVL_SIZE = struct.Struct("<2i")


def encoding(message: Any, msgtype: str) -> str:
    """Return how an image is coded, such as ``16UC1``, ``rgb8`` or ``jpeg``, of a message."""
    if msgtype == IMAGE:
        return str(message.encoding)
    return str(message.format).strip()


def decode_depth(message: Any, msgtype: str, where: str) -> NDArray[Any]:
    """Return the depth of a message, (H, W), uint16 mm or float32 m.

    Raises
    ------
    DatasetError
        If it is no depth image, or its size does not match its data; the message begins with
        ``where``.
    """
    if msgtype == IMAGE:
        return _decode_raw(message, where)
    data = bytes(message.data)
    coded = encoding(message, msgtype)
    if TRANSPORT not in coded:
        return decode_depth_png(data, where)
    kind = coded.split(";")[0].strip()
    if kind not in DTYPES:
        raise DatasetError(f"{where}: found {coded!r}, expected compressed depth: 16UC1 or 32FC1")
    if len(data) < CONFIG.size:
        raise DatasetError(f"{where}: found {len(data)} bytes, expected compressed depth")
    _, a, b = CONFIG.unpack_from(data)
    body = data[CONFIG.size :]
    image = _decode_rvl(body, where) if "rvl" in coded.lower() else decode_depth_png(body, where)
    if kind != "32FC1":
        return image
    metres = np.zeros(image.shape, np.float32)
    np.divide(a, image - np.float64(b), out=metres, where=image > 0, casting="unsafe")
    return metres


def _decode_raw(message: Any, where: str) -> NDArray[Any]:
    if message.encoding not in DTYPES:
        raise DatasetError(
            f"{where}: found images coded as {message.encoding}, expected {', '.join(DTYPES)}"
        )
    dtype = np.dtype(DTYPES[message.encoding]).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.asarray(message.data, np.uint8)
    if step < width * dtype.itemsize or len(data) < height * step:
        raise DatasetError(
            f"{where}: found {len(data)} bytes in rows of {step}, "
            f"expected {width}x{height} pixels of {dtype.itemsize} bytes"
        )
    rows = data[: height * step].reshape(height, step)[:, : width * dtype.itemsize]
    image = np.ascontiguousarray(rows).view(dtype)
    return image.astype(dtype.newbyteorder("="))


def _decode_rvl(data: bytes, where: str) -> NDArray[np.uint16]:
    """Decode run lengths of missing and other pixels, and the differences of the latter.

    Numbers are of three bits a nibble, lowest first, with a fourth that says whether more
    follow; nibbles stand in 32-bit words, highest first.
    """
    width, height = RVL_SIZE.unpack_from(data) if len(data) >= RVL_SIZE.size else (0, 0)
    # A pixel takes a nibble at least where it is there; all missing takes hardly any.
    if not (0 < width <= 2**14 and 0 < height <= 2**14):
        raise DatasetError(f"{where}: found RVL of {width}x{height} pixels, expected an image")
    numbers = _nibble_numbers(data[RVL_SIZE.size :])
    image = np.zeros(width * height, np.int64)
    at = done = previous = 0
    while done < len(image) and at + 1 < len(numbers):
        done += int(numbers[at])
        n = int(numbers[at + 1])
        coded = numbers[at + 2 : at + 2 + n]
        if n == 0 and numbers[at] == 0:
            break
        if done + n > len(image) or len(coded) < n:
            break
        steps = (coded >> 1) ^ -(coded & 1)
        image[done : done + n] = previous + np.cumsum(steps)
        previous = int(image[done + n - 1]) if n else previous
        done += n
        at += 2 + n
    if done != len(image) or image.min() < 0 or image.max() > 65535:
        raise DatasetError(
            f"{where}: found RVL of {done} pixels, expected {width}x{height}: truncated or damaged"
        )
    return image.reshape(height, width).astype(np.uint16)


def _nibble_numbers(data: bytes) -> NDArray[np.int64]:
    words = np.frombuffer(data[: len(data) // 4 * 4], "<u4")
    nibbles = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32)) & 15
    nibbles = nibbles.ravel().astype(np.int64)
    ends = np.flatnonzero(nibbles < 8)
    if len(ends) == 0:
        return np.empty(0, np.int64)
    nibbles = nibbles[: ends[-1] + 1]
    starts = np.concatenate([[0], ends[:-1] + 1])
    place = np.arange(len(nibbles)) - np.repeat(starts, np.diff([*starts, len(nibbles)]))
    # More than 32 bits are of no number: what does not fit is damage, and shows by itself.
    values = (nibbles & 7) << np.minimum(3 * place, 33)
    return np.asarray(np.add.reduceat(values, starts))
