"""Which topics of a bag are read, and what is said where that is not plain."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bags import INFO, TOPIC, png, time_ns, writing
from datasets import HEIGHT, WIDTH, ramp, refusal

from slam_bof.core import registry


def test_raw_images_win_over_the_same_compressed(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
        bag.compressed(
            f"{TOPIC}/compressedDepth",
            time_ns(0),
            bytes(12) + png(ramp(1)),
            "16UC1; compressedDepth",
        )
    np.testing.assert_array_equal(registry.open_dataset(path).frame(0).depth, ramp(0))


def test_topics_are_chosen_by_options(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera("/a/camera_info", fx=40)
        bag.camera("/b/camera_info", fx=50, frame="other")
        for name, number in (("/a/depth", 1), ("/b/depth", 2), ("/b/color", 3)):
            bag.image(name, time_ns(0), ramp(number), "16UC1" if number < 3 else "bgr8x")
    said = refusal("bag", path)
    assert "found 2 depth topics: /a/depth (16UC1), /b/depth (16UC1), expected one" in said
    assert "--set dataset.options.topic=/a/depth" in said
    dataset = registry.open_dataset(path, "bag", {"topic": "/b/depth"})
    assert dataset.intrinsics.fx == 50
    assert dataset.frame(0).depth[0, 1] == 3001
    options = {"topic": "/b/depth", "camera_info": "/a/camera_info"}
    assert registry.open_dataset(path, "bag", options).intrinsics.fx == 40
    given = {"topic": "/b/depth", "intrinsics": [9, 8, 7, 6]}
    assert registry.open_dataset(path, "bag", given).intrinsics.cy == 6
    assert "found no images on /c, expected one of: /a/depth, /b/color, /b/depth" in refusal(
        "bag", path, topic="/c"
    )
    assert "found images coded as bgr8x, expected 16UC1" in refusal("bag", path, topic="/b/color")
    assert "found no camera_info /c, expected one of: /a/" in refusal(
        "bag", path, topic="/a/depth", camera_info="/c"
    )


def test_names_of_any_length_are_refused_in_a_line_of_moderate_length(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(f"/{'[' * 4000}", time_ns(0), ramp(), "bgr8")
    said = refusal("bag", path)
    assert f"{path}: found no depth images (of images: /[[[" in said
    assert said.endswith("expected a topic of 16UC1 or 32FC1, raw or compressedDepth")
    assert len(said) < 1000


def test_recordings_of_the_realsense_viewer(tmp_path: Path) -> None:
    sensor = "/device_0/sensor_0"
    with writing(tmp_path, "ros1", "LZ4") as (bag, path):
        for name, fx in (("Depth_0", 40.0), ("Infrared_1", 50.0)):
            bag.camera(f"{sensor}/{name}/info/camera_info", fx=fx)
            bag.image(f"{sensor}/{name}/image/data", time_ns(0), ramp(int(fx)), "mono16")
    dataset = registry.open_dataset(path)
    assert dataset.intrinsics.fx == 40
    np.testing.assert_array_equal(dataset.frame(0).depth, ramp(40))


def test_a_camera_of_the_same_frame_will_do(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera("/x/info", fx=40)
        bag.camera("/y/info", fx=50, frame="other")
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    assert registry.open_dataset(path).intrinsics.fx == 40


def test_what_is_missing_is_told(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    said = refusal("bag", path)
    assert "found camera_info topics: none, expected one beside /depth; give --set" in said
    (tmp_path / "b").mkdir()
    with writing(tmp_path / "b", "mcap") as (bag, path):
        bag.camera("/camera_info", size=(64, 48))
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
        bag.image("/color", time_ns(0), ramp(), "rgb8")
    assert "found a camera of 64x48 pixels, expected 32x24 as /depth" in refusal("bag", path)
    assert "found no images on /x, expected one of: /color, /depth" in refusal(
        "bag", path, topic="/x"
    )
    (tmp_path / "c").mkdir()
    with writing(tmp_path / "c", "ros1") as (bag, path):
        bag.camera("/camera_info", fx=0)
        bag.image("/depth", time_ns(0), ramp(), "16UC1")
    assert "/camera_info: found a focal length fx of 0 px" in refusal("bag", path)
    (tmp_path / "d").mkdir()
    with writing(tmp_path / "d", "ros1") as (bag, path):
        bag.image("/color", time_ns(0), ramp(), "rgb8")
    assert "found no depth images (of images: /color (rgb8)), expected a topic" in refusal(
        "bag", path
    )


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"size": (4 * WIDTH, 4 * HEIGHT), "binning": 4}, (30, 31, 15.5, 11.5)),
        (
            {"size": (160, 120), "centre": (70.0, 50.0), "roi": (50, 40, WIDTH, HEIGHT)},
            (120, 124, 20, 10),
        ),
        (
            {"size": (160, 120), "centre": (80.0, 60.0), "roi": (50, 40, 2 * WIDTH, 2 * HEIGHT),
             "binning": 2},
            (60, 62, 14.75, 9.75),
        ),
        ({"binning": 4, "centre": (16.0, 12.0)}, (120, 124, 16, 12)),  # applied by the driver
    ],
)  # fmt: skip
def test_binning_and_region_of_interest_are_applied(
    tmp_path: Path, options: dict[str, Any], expected: tuple[float, ...]
) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO, **{"fx": 120.0, "fy": 124.0, "centre": (63.5, 47.5), **options})
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
    camera = registry.open_dataset(path).intrinsics
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == expected


def test_decimated_depth_names_the_option_that_helps(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        size = (4 * WIDTH, 4 * HEIGHT)
        bag.camera(INFO, size=size, fx=120.0, fy=124.0, centre=(63.5, 47.5))
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
    said = refusal("bag", path)
    assert f"found a camera of 128x96 pixels, expected 32x24 as {TOPIC}; if the images" in said
    option = "give --set dataset.options.intrinsics=[30,31,15.5,11.5]"
    assert said.endswith(option)
    assert registry.open_dataset(path, "bag", {"intrinsics": [30, 31, 15.5, 11.5]}).frame(0)
