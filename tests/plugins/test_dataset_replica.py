from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, refusal, write_png

from slam_bof.core import registry
from slam_bof.errors import DatasetError

EYE = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Three frames of 32x24 pixels, and the camera beside the scene."""
    folder = tmp_path / "room0"
    for number in range(3):
        write_png(folder / "results" / f"depth{number:06d}.png", ramp(number))
        image = np.full((HEIGHT, WIDTH, 3), (0, 0, 200), np.uint8)
        write_png(folder / "results" / f"frame{number:06d}.jpg", image)
    poses = np.array([pose(number) for number in range(3)])
    np.savetxt(folder / "traj.txt", poses.reshape(3, 16))
    camera = {"w": WIDTH, "h": HEIGHT, "fx": 30, "fy": 31, "cx": 15.5, "cy": 11.5, "scale": 6553.5}
    (tmp_path / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder


def test_obeys_the_contract(scene: Path) -> None:
    check_dataset(registry.open_dataset(scene))


def test_reads_what_was_written(scene: Path) -> None:
    dataset = registry.open_dataset(scene)
    assert dataset.name == "replica"
    frame = dataset.frame(2)
    assert frame.stamp_s == pytest.approx(2 / 30)
    np.testing.assert_array_equal(frame.depth, (ramp(2) / 6553.5).astype(np.float32))
    camera = dataset.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 15.5, 11.5)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[2], pose(2), atol=1e-12)
    color = dataset.color(0)
    assert color is not None
    assert color[5, 5, 0] > 190
    assert color[5, 5, 2] < 10


def test_the_published_camera_is_known(tmp_path: Path) -> None:
    write_png(tmp_path / "results" / "depth000000.png", np.ones((680, 1200), np.uint16))
    dataset = registry.open_dataset(tmp_path)
    camera = dataset.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (600.0, 600.0, 599.5, 339.5)
    assert dataset.groundtruth() is None


def test_frames_keep_their_poses_where_some_are_missing(scene: Path) -> None:
    (scene / "results" / "depth000001.png").unlink()
    dataset = registry.open_dataset(scene)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[1], pose(2), atol=1e-12)
    assert dataset.frame(1).stamp_s == pytest.approx(2 / 30)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{EYE}\n\n{EYE}\n", "line 2: found 0 numbers, expected 16"),
        (f"{EYE}\n1 2 3\n{EYE}\n", "line 2: found 3 numbers, expected 16"),
        (f"{EYE}\n2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1\n{EYE}\n", "line 2: found a matrix that is no"),
        (f"{EYE}\n{'nan ' * 16}\n{EYE}\n", "line 2: found NaN"),
        (f"{EYE}\n{'x ' * 16}\n{EYE}\n", "line 2: could not convert string to float: 'x'"),
    ],
)
def test_poses_that_are_none_are_unknown(
    scene: Path, caplog: pytest.LogCaptureFixture, text: str, message: str
) -> None:
    (scene / "traj.txt").write_text(text)
    groundtruth = registry.open_dataset(scene).groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses).all(axis=(1, 2)).tolist() == [False, True, False]
    assert message in caplog.text


def test_frames_beyond_the_last_pose_have_none(scene: Path) -> None:
    (scene / "traj.txt").write_text(f"{EYE}\n")
    groundtruth = registry.open_dataset(scene).groundtruth()
    assert groundtruth is not None
    assert np.isfinite(groundtruth.poses).all(axis=(1, 2)).tolist() == [True, False, False]
    (scene / "traj.txt").write_text("")
    assert registry.open_dataset(scene).groundtruth() is None


@pytest.mark.parametrize(
    "text", ["{}", "[1]", '{"camera": {"w": 32}}', "{", '{"camera": {"w": "wide"}}']
)
def test_cameras_that_are_none_are_refused(scene: Path, text: str) -> None:
    (scene / "cam_params.json").write_text(text)
    said = refusal("replica", scene)
    assert "cam_params.json: found " in said
    assert "expected a camera with positive numbers w, h, fx" in said


def test_images_of_another_size_than_the_camera_are_refused(scene: Path) -> None:
    (scene.parent / "cam_params.json").unlink()
    assert "found 32x24 pixels, expected 1200x680 as NICE-SLAM, since there is no cam" in (
        refusal("replica", scene)
    )
    assert "expected Replica in NICE-SLAM's format" in refusal("replica", scene.parent)


def test_a_scale_by_which_all_lies_beyond_a_kilometre_is_refused(scene: Path) -> None:
    camera = json.loads((scene.parent / "cam_params.json").read_text())["camera"]
    (scene / "cam_params.json").write_text(json.dumps({"camera": {**camera, "scale": True}}))
    dataset = registry.open_dataset(scene)
    with pytest.raises(DatasetError, match=r"expected some within 1000 m: is the unit right\?"):
        dataset.frame(0)
