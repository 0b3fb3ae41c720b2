"""Bags read back frame by frame, at their times; and damaged ones."""

from __future__ import annotations

import os
import shutil
import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from bags import FORMATS, INFO, TOPIC, time_ns, write, writing
from datasets import HEIGHT, WIDTH, check_dataset, ramp, refusal

from slam_bof.core import registry
from slam_bof.errors import DatasetError


@pytest.mark.parametrize("form", FORMATS)
def test_reads_what_was_written(tmp_path: Path, form: str) -> None:
    path = write(tmp_path, form, pad=6)
    dataset = registry.open_dataset(path)
    assert (dataset.name, len(dataset)) == ("bag", 4)
    check_dataset(dataset)
    for number in (0, 3, 1, 2, 3):
        frame = dataset.frame(number)
        assert frame.stamp_s == pytest.approx(time_ns(number) * 1e-9, abs=1e-6)
        assert frame.depth.dtype == np.uint16
        np.testing.assert_array_equal(frame.depth, ramp(number))
    camera = dataset.intrinsics
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 16, 12)


@pytest.mark.parametrize(
    ("form", "packing"),
    [
        ("ros1", "BZ2"),
        ("ros1", "LZ4"),
        ("sqlite3", "MESSAGE"),
        ("sqlite3", "FILE"),
        ("mcap", "MESSAGE"),
        ("mcap", "FILE"),
        ("mcap", "STORAGE"),
    ],
)
def test_packed_bags_are_read(tmp_path: Path, form: str, packing: str) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, packing))
    check_dataset(dataset)
    for number in (3, 1, 2):
        np.testing.assert_array_equal(dataset.frame(number).depth, ramp(number))


@pytest.mark.parametrize("form", ["sqlite3", "mcap"])
def test_a_single_file_of_ros_2_is_a_bag(tmp_path: Path, form: str) -> None:
    suffix = {"sqlite3": ".db3", "mcap": ".mcap"}[form]
    (file,) = write(tmp_path, form).glob(f"*{suffix}")
    alone = file.rename(tmp_path / f"alone{suffix}")
    assert len(registry.open_dataset(alone)) == 4
    assert registry.recognise_dataset(alone).why.startswith("alone.")


@pytest.mark.parametrize("form", FORMATS)
def test_times_without_stamps_are_those_of_reception(
    tmp_path: Path, form: str, caplog: pytest.LogCaptureFixture
) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, stamp_ns=0))
    assert dataset.frame(1).stamp_s == pytest.approx((time_ns(1) + 5_000_000) * 1e-9, abs=1e-6)
    assert "stamps do not grow; taking times of reception" in caplog.text


@pytest.mark.parametrize("form", FORMATS)
def test_images_received_at_once_are_told_apart(tmp_path: Path, form: str) -> None:
    dataset = registry.open_dataset(write(tmp_path, form, received_ns=time_ns(9)))
    for number in (2, 0, 3, 1):
        np.testing.assert_array_equal(dataset.frame(number).depth, ramp(number))


@pytest.mark.parametrize(
    ("spelling", "unit_m"), [("Depth Units", 0.00025), ("Depth_Units", 0.0001)]
)
def test_a_realsense_bag_states_its_unit(tmp_path: Path, spelling: str, unit_m: float) -> None:
    topic = "/device_0/sensor_0/Depth_0/image/data"
    with writing(tmp_path, "ros1") as (bag, path):
        for sensor, value in ((0, unit_m), (1, 1.0)):  # the colour camera has such an option too
            option = f"/device_0/sensor_{sensor}/option/{spelling}/value"
            bag.write(option, time_ns(0), bag.make("std_msgs/msg/Float32", data=value))
        bag.camera("/device_0/sensor_0/Depth_0/info/camera_info")
        bag.image(topic, time_ns(0), ramp(), "mono16")
    dataset = registry.open_dataset(path)
    np.testing.assert_allclose(dataset.frame(0).depth_m(), ramp() * unit_m, rtol=1e-6)
    other = registry.open_dataset(path, "bag", {"depth_scale": 2000})
    np.testing.assert_allclose(other.frame(0).depth_m(), ramp() / 2000, rtol=1e-6)


def test_floats_in_millimetres_are_scaled_by_an_option(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), ramp().astype(np.float32), "32FC1")
    assert registry.open_dataset(path).frame(0).depth_m().max() > 1000  # a run warns of the unit
    frame = registry.open_dataset(path, "bag", {"depth_scale": 1000}).frame(0)
    np.testing.assert_allclose(frame.depth_m(), ramp() / 1000, rtol=1e-6)


def test_a_value_of_no_depth_among_metres_is_missing(tmp_path: Path) -> None:
    metres = (ramp() / 1000).astype(np.float32)
    broken = metres.copy()
    broken[3, 4] = 160_890.0
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), broken, "32FC1")
    expected = metres.copy()
    expected[3, 4] = 0.0
    np.testing.assert_array_equal(registry.open_dataset(path).frame(0).depth_m(), expected)


def test_a_time_that_is_none_is_one_line(tmp_path: Path) -> None:
    path = write(tmp_path, "sqlite3")
    with closing(sqlite3.connect(next(path.glob("*.db3")))) as db:
        db.execute("UPDATE messages SET timestamp = 'x' WHERE id = 3")
        db.commit()
    with pytest.raises(DatasetError, match="found a bag that cannot be read"):
        registry.open_dataset(path)


# Parts


def write_parts(folder: Path, form: str, names: list[str], *, pause_s: float = 0.0) -> Path:
    """Three images in each file; the camera only in the first, as latched topics are."""
    walk = folder / "walk"
    walk.mkdir()
    for part, name in enumerate(names):
        with writing(folder, form) as (bag, path):
            if part == 0:
                bag.camera(INFO)
            for number in range(3 * part, 3 * part + 3):
                bag.image(TOPIC, time_ns(number) + int(part * pause_s * 1e9), ramp(number), "16UC1")
        file = path if path.is_file() else next(path.glob("*.mcap"))
        file.rename(walk / name)
        if path.is_dir():
            shutil.rmtree(path)
    return walk


@pytest.mark.parametrize(
    ("form", "names"),
    [
        ("ros1", [f"walk_2023-06-14-10-00-0{9 - k}_{k}.bag" for k in range(3)]),
        ("mcap", [f"walk_{k}.mcap" for k in (9, 10, 11)]),
    ],
)
def test_the_parts_of_a_recording_are_one_sequence(
    tmp_path: Path, form: str, names: list[str]
) -> None:
    walk = write_parts(tmp_path, form, names)
    assert "in 3 parts" in registry.recognise_dataset(walk).why
    dataset = registry.open_dataset(walk)
    check_dataset(dataset)
    assert (len(dataset), dataset.sequence.rpartition("/")[2]) == (9, "walk")
    for number in (0, 8, 4, 5):
        np.testing.assert_array_equal(dataset.frame(number).depth, ramp(number))


def test_recordings_that_do_not_follow_each_other_are_no_parts(tmp_path: Path) -> None:
    walk = write_parts(tmp_path, "ros1", ["run_1.bag", "run_2.bag"], pause_s=60.0)
    said = refusal("bag", walk)
    assert "found 2 bags that are 60 s apart or overlap, expected the parts of one" in said
    assert f"give one of them, such as {walk / 'run_1.bag'}" in said


def test_a_bag_that_was_not_closed_names_the_way(tmp_path: Path) -> None:
    active = write(tmp_path, "ros1").rename(tmp_path / "toy.bag.active")
    assert "rename it to toy.bag and run: rosbag reindex toy.bag" in refusal("auto", active)


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_a_bag_with_a_name_in_capitals_is_opened(tmp_path: Path, form: str) -> None:
    bag = write(tmp_path, form)
    bag = next(bag.glob("*.mcap")) if bag.is_dir() else bag
    loud = bag.rename(tmp_path / f"TOY{bag.suffix.upper()}")
    dataset = registry.open_dataset(loud)
    check_dataset(dataset)
    np.testing.assert_array_equal(dataset.frame(1).depth, ramp(1))


def test_a_pipe_is_no_bag_and_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "toy.bag")
    assert "found something else, expected a ROS 1 bag" in refusal("bag", tmp_path / "toy.bag")
    assert "expected the folder of a sequence" in refusal("auto", tmp_path / "toy.bag")
    bag = write(tmp_path, "mcap")
    part = next(bag.glob("*.mcap"))
    part.unlink()
    os.mkfifo(part)
    assert f"{part}: found a named pipe" in refusal("bag", bag)


# Damage


def test_one_bad_image_is_told_when_it_is_read(tmp_path: Path) -> None:
    with writing(tmp_path, "ros1") as (bag, path):
        bag.camera(INFO)
        for number in range(4):
            image = ramp()[:12] if number == 1 else ramp(number)
            bag.image(TOPIC, time_ns(number), image, "rgb8" if number == 2 else "16UC1")
    dataset = registry.open_dataset(path)
    with pytest.raises(DatasetError, match=r"image 1: found 32x12 pixels, expected 32x24"):
        dataset.frame(1)
    with pytest.raises(
        DatasetError, match=r"toy\.bag: /camera.*image 2: found images coded as rgb8"
    ):
        dataset.frame(2)
    np.testing.assert_array_equal(dataset.frame(3).depth, ramp(3))


@pytest.mark.parametrize("form", FORMATS)
@pytest.mark.parametrize("share", [0.0, 0.02, 0.5, 0.9])
def test_truncated_bags_are_refused(tmp_path: Path, form: str, share: float) -> None:
    path = write(tmp_path, form)
    file = path if path.is_file() else next(f for f in path.iterdir() if f.suffix != ".yaml")
    data = file.read_bytes()
    file.write_bytes(data[: int(share * len(data))])
    assert str(path) in refusal("bag", path)


def test_mislabelled_files_are_refused(tmp_path: Path) -> None:
    bag = write(tmp_path, "ros1")
    (mcap,) = write(tmp_path, "mcap").glob("*.mcap")
    wrong = mcap.rename(tmp_path / "wrong.bag")
    assert "found an MCAP file, expected a ROS 1 bag, as its name says" in refusal("bag", wrong)
    text = tmp_path / "text.bag"
    text.write_text("no bag")
    assert "text.bag: found something else, expected a ROS 1 bag" in refusal("bag", text)
    assert "found text.bag, toy.bag, wrong.bag, expected one .bag" in refusal("bag", tmp_path)
    assert "found a ROS 1 bag, expected an MCAP file" in refusal(
        "bag", bag.rename(tmp_path / "wrong.mcap")
    )


def test_an_empty_bag_is_refused(tmp_path: Path) -> None:
    with writing(tmp_path, "ros1") as (_, path):
        pass
    assert "toy.bag: found " in refusal("bag", path)
