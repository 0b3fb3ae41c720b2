"""Images whose headers claim more than there is take no memory."""

import struct
import zlib

import cv2
import numpy as np
import pytest

from slam_bof.core import decode_image, images, peak_rss_mb

DEPTH = (np.arange(120 * 160).reshape(120, 160) % 5000).astype(np.uint16)
COLOR = np.random.default_rng(0).integers(0, 255, (120, 160, 3), np.uint8)


def coded(suffix, image):
    return cv2.imencode(suffix, image)[1].tobytes()


def png_of(width, height):
    """A PNG file with another size in its header, under a right checksum."""
    data = bytearray(coded(".png", DEPTH))
    data[16:24] = struct.pack(">2I", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


def jpeg_of(width, height):
    """A JPEG file with another size in its frame header."""
    data = bytearray(coded(".jpg", COLOR))
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">2H", height, width)
    return bytes(data)


def tiff_of(width, height, *, tags=(256, 257), kind=4, count=1, order="<"):
    """A TIFF file with other values of two tags of its directory."""
    pixels = np.array(DEPTH).astype(order + "u2").tobytes()
    values = {256: 160, 257: 120, 258: 16, 259: 1, 262: 1, 273: 8, 277: 1, 278: 120}
    values[279] = len(pixels)
    entries = {tag: (4, 1, value) for tag, value in values.items()}
    entries |= dict(zip(tags, ((kind, count, width), (kind, count, height)), strict=True))
    directory = struct.pack(order + "H", len(entries))
    for tag, (of, n, value) in sorted(entries.items()):
        packed = struct.pack(order + ("I" if of == 4 else "H2x"), value)
        directory += struct.pack(order + "2HI", tag, of, n) + packed
    start = {"<": b"II*\0", ">": b"MM\0*"}[order] + struct.pack(order + "I", 8 + len(pixels))
    return start + pixels + directory + bytes(4)


def chunk_of(length):
    """A PNG file whose second chunk says another length."""
    data = bytearray(coded(".png", DEPTH))
    data[33:37] = struct.pack(">I", length)
    return bytes(data)


@pytest.mark.parametrize(
    ("data", "expected"),
    [
        (coded(".png", DEPTH), DEPTH),
        (coded(".tiff", DEPTH), DEPTH),
        (coded(".tiff", DEPTH.astype(np.float32)), DEPTH),
        (tiff_of(160, 120), DEPTH),
        (tiff_of(160, 120, kind=3, order=">"), DEPTH),
        (coded(".png", COLOR), COLOR),
    ],
)
def test_whole_images_are_read(data, expected):
    np.testing.assert_array_equal(decode_image(data), expected)


def test_colour_is_read_in_grey_too():
    data = coded(".jpg", COLOR)
    np.testing.assert_array_equal(decode_image(data), cv2.imdecode(np.frombuffer(data, "u1"), -1))
    assert decode_image(data, cv2.IMREAD_GRAYSCALE).shape == (120, 160)
    beside_metadata = data[:2] + b"\xff\xe1\0\x0b\xff\xc0\xff\xff\xff\xff\xff\xff\xff" + data[2:]
    assert decode_image(beside_metadata).shape == (120, 160, 3)
    assert decode_image(jpeg_of(80, 120)) is not None


LARGE = {
    "png": coded(".png", DEPTH),
    "jpeg": coded(".jpg", COLOR),
    "tiff": coded(".tiff", DEPTH),
    "big-endian tiff": tiff_of(160, 120, kind=3, order=">"),
}


@pytest.mark.parametrize("name", LARGE)
def test_the_header_decides_in_every_format(name, monkeypatch):
    monkeypatch.setattr(images, "MAX_IMAGE_PIXELS", 160 * 120)
    assert decode_image(LARGE[name]) is not None
    monkeypatch.setattr(images, "MAX_IMAGE_PIXELS", 160 * 120 - 1)
    assert decode_image(LARGE[name]) is None


HOSTILE = {
    "png of 100 gigapixels": png_of(320_000, 320_000),
    "png of nothing": png_of(0, 120),
    "jpeg of 4 gigapixels": jpeg_of(65_000, 65_000),
    "jpeg of a gigapixel": b"\xff\xd8garbage" + jpeg_of(32_000, 32_000)[2:],
    "tiff of a gigapixel": tiff_of(32_000, 32_000),
    "tiff of a gigapixel, big-endian": tiff_of(32_000, 32_000, kind=3, order=">"),
    "tiff with tiles of a gigapixel": tiff_of(32_000, 32_000, tags=(322, 323)),
    "tiff whose width is elsewhere": tiff_of(160, 120, count=2),
    "tiff of nothing": tiff_of(0, 120),
    "cut tiff": tiff_of(160, 120)[:-60],
    "tiff without a directory": b"II*\0\xff\xff\xff\xff",
    "another format": coded(".bmp", COLOR),
    "chunk of 2 GB": chunk_of(2_147_000_000),
    "chunk of 4 GB": chunk_of(2**32 - 1),
    "cut header": coded(".png", DEPTH)[:14],
    "nothing": b"",
    "text": b"not an image",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_is_too_much_is_no_image_and_takes_no_memory(name):
    before_mb = peak_rss_mb()
    assert decode_image(HOSTILE[name]) is None
    assert peak_rss_mb() - before_mb < 200.0
