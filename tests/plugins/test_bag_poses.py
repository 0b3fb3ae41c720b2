"""Poses that a robot left in its bag, as the truth and as odometry."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bags import FRAME, INFO, START_NS, TOPIC, time_ns, writing
from conftest import CAMERA, box_room_depth_mm
from datasets import check_dataset, pose, ramp, refusal
from numpy.typing import NDArray
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.geometry import read_tum, se3

T_BASE_CAMERA = se3.exp(np.array([0.0, 1.2, 0.0, 0.1, -0.2, 0.3]))


T_MAP_ODOM = se3.exp(np.array([0.0, 0.0, 0.5, 1.0, 2.0, 0.0]))


def write_walk(folder: Path, form: str, *, topic: str = "/odom") -> Path:
    """Four images, and between any two of them where the robot is by its odometry."""
    with writing(folder, form) as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", "mount", np.eye(4))
        bag.tf("/tf_static", START_NS, "mount", FRAME, T_BASE_CAMERA)
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
            bag.odometry(topic, time_ns(number - 0.5), pose(number - 0.5), "base_link")
    return path


def write_tf_walk(folder: Path, form: str) -> Path:
    """The same, told by transforms from the map down to the camera."""
    with writing(folder, form) as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", FRAME, T_BASE_CAMERA)
        for number in range(-1, 5):
            bag.tf("/tf", time_ns(number), "odom", "base_link", pose(number))
            bag.tf("/tf", time_ns(number), "map", "odom", T_MAP_ODOM)
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
    return path


@pytest.mark.parametrize("form", ["ros1", "mcap"])
def test_odometry_is_carried_to_the_camera(tmp_path: Path, form: str) -> None:
    path = write_walk(tmp_path, form)
    dataset = registry.open_dataset(path, "bag", {"groundtruth": "/odom"})
    check_dataset(dataset)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[1], pose(1) @ T_BASE_CAMERA, atol=1e-5)
    assert np.isnan(groundtruth.poses[3]).all(), "after the last pose"
    assert registry.open_dataset(path).groundtruth() is None


@pytest.mark.parametrize("form", ["ros1", "sqlite3"])
def test_transforms_are_composed_up_to_the_world(tmp_path: Path, form: str) -> None:
    path = write_tf_walk(tmp_path, form)
    poses = {}
    for world in ("map", "odom"):
        options = {"groundtruth": "/tf", "world_frame": world}
        groundtruth = registry.open_dataset(path, "bag", options).groundtruth()
        assert groundtruth is not None
        poses[world] = groundtruth.poses
    np.testing.assert_allclose(poses["odom"][2], pose(2) @ T_BASE_CAMERA, atol=1e-5)
    np.testing.assert_allclose(poses["map"], T_MAP_ODOM @ poses["odom"], atol=1e-9)
    said = refusal("bag", path, groundtruth="/tf", world_frame="earth")
    assert "expected a way up to 'earth'; known frames: base_link, camera" in said
    assert "/camera/depth/camera_info: found sensor_msgs/msg/CameraInfo, expected poses: /tf" in (
        refusal("bag", path, groundtruth=INFO)
    )


@pytest.mark.parametrize("first", ["map", "odom"])
def test_of_two_parents_the_one_on_the_way_counts(tmp_path: Path, first: str) -> None:
    """Motion capture and wheels each say where the base is, by frames of their own."""
    parents = {"map": T_MAP_ODOM, "odom": np.eye(4)}
    order = [first, *(parents.keys() - {first})]
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", FRAME, T_BASE_CAMERA)
        for number in range(-1, 5):
            for parent in order:
                bag.tf("/tf", time_ns(number), parent, "base_link", parents[parent] @ pose(number))
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
    for world, T_world in parents.items():
        options = {"groundtruth": "/tf", "world_frame": world}
        groundtruth = registry.open_dataset(path, "bag", options).groundtruth()
        assert groundtruth is not None
        expected = T_world @ pose(2) @ T_BASE_CAMERA
        np.testing.assert_allclose(groundtruth.poses[2], expected, atol=1e-5)
    said = refusal("bag", path, groundtruth="/tf", world_frame="earth")
    assert "<- base_link <- map and " in said
    assert "<- base_link <- odom" in said


def test_two_ways_to_the_world_are_refused(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.tf("/tf_static", START_NS, "base_link", FRAME, T_BASE_CAMERA)
        for number in range(4):
            bag.tf("/tf", time_ns(number), "map", "base_link", pose(number))
            bag.tf("/tf", time_ns(number), "odom", "base_link", pose(number))
            bag.tf("/tf", time_ns(number), "map", "odom", T_MAP_ODOM)
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
    assert (
        f"found 2 ways {FRAME} <- base_link <- map and {FRAME} <- base_link <- odom <- map, "
        "expected one"
    ) in refusal("bag", path, groundtruth="/tf")


@pytest.mark.parametrize("static", ["/robot1/tf_static", "/tf_static"])
@pytest.mark.parametrize("topic", ["/robot1/tf", "/robot1/odom"])
def test_one_robot_of_several_has_its_own_transforms(
    tmp_path: Path, static: str, topic: str
) -> None:
    """Another robot's camera is mounted elsewhere, under the same names."""
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.tf("/robot2/tf_static", START_NS, "base_link", FRAME, np.eye(4))
        bag.tf(static, START_NS, "base_link", FRAME, T_BASE_CAMERA)
        for number in range(-1, 5):
            bag.tf("/robot1/tf", time_ns(number), "odom", "base_link", pose(number))
            bag.odometry("/robot1/odom", time_ns(number), pose(number), "base_link")
        for number in range(4):
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
    options = {"groundtruth": topic, "world_frame": "odom"}
    groundtruth = registry.open_dataset(path, "bag", options).groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[2], pose(2) @ T_BASE_CAMERA, atol=1e-5)
    np.testing.assert_allclose(play(path), WALKED, atol=1e-5)


# As odometry


def play(path: Path, **options: object) -> NDArray[np.float64]:
    """What the recorded odometry says of each frame of a bag."""
    odometry = registry.build("odometry", "recorded", {"file": path, **options})
    dataset = registry.open_dataset(path)
    return np.array([odometry.process(dataset.frame(i)) for i in range(len(dataset))])


def cannot_play(path: Path, **options: object) -> str:
    with pytest.raises(DatasetError) as caught:
        play(path, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


CAMERA_PATH = np.array([pose(number) @ T_BASE_CAMERA for number in range(4)])
WALKED = se3.inverse(CAMERA_PATH[0]) @ CAMERA_PATH
"""T_first_camera."""


@pytest.mark.parametrize("form", ["ros1", "sqlite3", "mcap"])
def test_odometry_of_a_bag_is_played_back(tmp_path: Path, form: str) -> None:
    found = play(write_walk(tmp_path, form))
    np.testing.assert_allclose(found[:3], WALKED[:3], atol=1e-5)
    last = se3.inverse(CAMERA_PATH[0]) @ pose(2.5) @ T_BASE_CAMERA  # which still holds
    np.testing.assert_allclose(found[3], last, atol=1e-5)


def test_transforms_of_a_bag_are_played_back(tmp_path: Path) -> None:
    path = write_tf_walk(tmp_path, "mcap")
    np.testing.assert_allclose(play(path), WALKED, atol=1e-5)
    np.testing.assert_allclose(play(path, world_frame="map"), WALKED, atol=1e-5)
    said = cannot_play(path, world_frame="earth")
    assert "expected a way up to 'earth'" in said


def test_what_moves_may_be_named(tmp_path: Path) -> None:
    base = np.array([pose(number) for number in range(4)])
    found = play(write_walk(tmp_path, "mcap"), camera_frame="base_link")
    np.testing.assert_allclose(found[:3], (se3.inverse(base[0]) @ base)[:3], atol=1e-5)


def test_odometry_that_is_not_plain_is_told(tmp_path: Path) -> None:
    with writing(tmp_path, "mcap") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
    said = cannot_play(path)
    assert f"found no poses (topics: {INFO}, {TOPIC}), expected nav_msgs/Odometry, poses" in said
    with writing(tmp_path, "ros1") as (bag, path):
        bag.camera(INFO)
        bag.image(TOPIC, time_ns(0), ramp(), "16UC1")
        for topic in ("/a", "/b"):
            bag.odometry(topic, time_ns(0), pose(0), FRAME)
    assert "found 2 topics of poses: /a, /b, expected one; choose by --set odometry.options" in (
        cannot_play(path)
    )
    assert play(path, topic="/a").shape == (1, 4, 4)
    assert "/c: found no such topic, expected poses: /a, /b" in cannot_play(path, topic="/c")
    with pytest.raises(DatasetError, match="found no bag, expected one"):
        registry.build("odometry", "recorded", {"file": tmp_path / "none", "format": "bag"})


def test_a_bag_is_run_with_its_own_odometry(tmp_path: Path) -> None:
    """From the command line, with no file written by hand."""
    turns = [se3.exp(np.array([0, 0.05 * k, 0, 0.02 * k, 0, 0])) for k in range(6)]
    with writing(tmp_path, "mcap") as (bag, path):
        c = CAMERA
        bag.camera(INFO, size=(c.width, c.height), fx=c.fx, fy=c.fy, centre=(c.cx, c.cy))
        for number, T in enumerate(turns):
            bag.image(TOPIC, time_ns(number), box_room_depth_mm(CAMERA, T), "16UC1")
            bag.odometry("/odom", time_ns(number), T, FRAME)
    recorded = ["--set", "odometry.name=recorded", "--set", f"odometry.options.file={path}"]
    out = tmp_path / "runs"
    result = CliRunner().invoke(app, ["run", str(path), *recorded, "-o", str(out), "--quiet"])
    assert result.exit_code == 0, result.output
    np.testing.assert_allclose(
        read_tum(out / "latest" / "trajectory_odometry_tum.txt").poses, turns, atol=1e-6
    )


@pytest.mark.parametrize("form", ["ros1", "sqlite3"])
def test_a_pose_that_is_far_away_is_unknown(tmp_path: Path, form: str) -> None:
    far = pose(1)
    far[0, 3] = 1e12
    with writing(tmp_path, form) as (bag, path):
        bag.camera(INFO)
        for number in range(5):
            if number < 4:
                bag.image(TOPIC, time_ns(number), ramp(number), "16UC1")
            bag.odometry("/odom", time_ns(number), far if number == 1 else pose(number), FRAME)
    truth = registry.open_dataset(path, "bag", {"groundtruth": "/odom"}).groundtruth()
    assert truth is not None
    assert np.isnan(truth.poses).any(axis=(1, 2)).tolist() == [False, True, False, False]
