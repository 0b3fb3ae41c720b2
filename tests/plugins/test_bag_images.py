"""Depth images of a bag in all their codings."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from bags import INFO, TOPIC, png, time_ns, writing
from datasets import HEIGHT, WIDTH, ramp
from numpy.typing import NDArray

from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof_plugins.bag_images import COMPRESSED, decode_depth


@pytest.mark.parametrize("form", ["ros1", "mcap"])
@pytest.mark.parametrize("big", [False, True])
def test_both_byte_orders_and_both_units(tmp_path: Path, form: str, big: bool) -> None:
    metres = ramp() / np.float32(1000)
    metres[0, :2] = (np.nan, np.inf)
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), metres, "32FC1", big=big, pad=3)
        bag.image(TOPIC, time_ns(1), ramp(), "16UC1", big=big)
    dataset = registry.open_dataset(path)
    assert dataset.frame(0).depth.dtype == np.float32
    np.testing.assert_array_equal(dataset.frame(0).depth, metres)
    assert dataset.frame(0).depth_m()[0, :2].tolist() == [0, 0]
    np.testing.assert_array_equal(dataset.frame(1).depth, ramp())


def rvl(image: NDArray[np.uint16]) -> bytes:
    """Encode as the paper's listing does, number by number."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            low, value = value & 7, value >> 3
            nibbles.append(low | (8 if value else 0))
            if not value:
                return

    pixels, at, previous = image.ravel().tolist(), 0, 0
    while at < len(pixels):
        for missing in (True, False):
            end = at
            while end < len(pixels) and (pixels[end] == 0) == missing:
                end += 1
            put(end - at)
            if missing:
                at = end
        for pixel in pixels[at:end]:
            step = pixel - previous
            put(2 * step if step >= 0 else -2 * step - 1)
            previous = pixel
        at = end
    nibbles += [0] * (-len(nibbles) % 8)
    words = [
        sum(nibble << 28 - 4 * k for k, nibble in enumerate(nibbles[i : i + 8]))
        for i in range(0, len(nibbles), 8)
    ]
    return struct.pack("<2i", image.shape[1], image.shape[0]) + struct.pack(
        f"<{len(words)}I", *words
    )


def holes() -> NDArray[np.uint16]:
    image = np.random.default_rng(0).integers(0, 65536, (HEIGHT, WIDTH)).astype(np.uint16)
    image[3:7, 5:] = 0
    image[-1, -5:] = 0
    return image


@pytest.mark.parametrize("form", ["ros1", "sqlite3"])
@pytest.mark.parametrize(
    ("coding", "code"),
    [
        ("16UC1; compressedDepth", lambda image: bytes(12) + png(image)),
        ("16UC1; compressedDepth png", lambda image: bytes(12) + png(image)),
        ("16UC1; compressedDepth rvl", lambda image: bytes(12) + rvl(image)),
        ("16UC1; png compressed ", png),
    ],
)
def test_compressed_depth(
    tmp_path: Path, form: str, coding: str, code: Callable[[NDArray[np.uint16]], bytes]
) -> None:
    topic = f"{TOPIC}/compressedDepth"
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        for number, image in enumerate((ramp(), holes())):
            bag.compressed(topic, time_ns(number), code(image), coding)
    dataset = registry.open_dataset(path)
    np.testing.assert_array_equal(dataset.frame(0).depth, ramp())
    np.testing.assert_array_equal(dataset.frame(1).depth, holes())


def test_compressed_metres_are_inverse_depth(tmp_path: Path) -> None:
    # As compressed_depth_image_transport has it: 10 m at most, quantised by 100.
    a = 100.0 * (100.0 + 1.0)
    b = 1.0 - a / 10.0
    metres = ramp() / np.float32(1000)
    with np.errstate(divide="ignore"):
        inverse = np.where(metres > 0, a / metres + b, 0).astype(np.uint16)
    data = struct.pack("<i2f", 0, a, b) + png(inverse)
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.compressed(f"{TOPIC}/compressedDepth", time_ns(0), data, "32FC1; compressedDepth png")
    depth = registry.open_dataset(path).frame(0).depth
    assert depth.dtype == np.float32
    assert depth[0, 0] == 0
    np.testing.assert_allclose(depth, metres, rtol=2e-3)


def test_damaged_rvl_is_refused() -> None:
    whole = bytes(12) + rvl(holes())
    sizes = [bytes(12), whole[:14], whole[:60], bytes(12) + struct.pack("<2i", -4, 9) + whole[20:]]
    for data in [*sizes, whole[:-8], bytes(12) + struct.pack("<2i", 9999, 9999)]:
        message = SimpleNamespace(data=data, format="16UC1; compressedDepth rvl")
        with pytest.raises(DatasetError, match=r"x\.bag: found RVL of "):
            decode_depth(message, COMPRESSED, "x.bag")
