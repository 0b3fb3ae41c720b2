from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, refusal, trajectory, write_png
from numpy.typing import NDArray

from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.geometry import write_tum

CAMERA = {"width": WIDTH, "height": HEIGHT, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5}


def write(folder: Path, names: list[str], **more: object) -> Path:
    """A folder of ramps under these names."""
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.suffix == ".npy":
            np.save(path, ramp(number))
        else:
            write_png(path, ramp(number))
    (folder / "intrinsics.json").write_text(json.dumps({**CAMERA, **more}))
    return folder


NEAR_2021 = [1617685268.17738, 1617685268.210745]
"""A thirtieth of a second in April 2021."""


def stamps(folder: Path) -> list[float]:
    dataset = registry.open_dataset(folder)
    return [dataset.frame(i).stamp_s for i in range(len(dataset))]


@pytest.mark.parametrize(
    "names",
    [
        ["depth/12.500000.png", "depth/12.533333.png"],
        ["depth/a.npy", "depth/b.npy"],
        ["frame-000000.depth.png", "frame-000007.depth.png"],
        ["000.png", "001.npy"],
        ["depth/0000.PNG", "depth/0001.PNG"],
        ["0.depth.PNG", "1.depth.PNG"],
    ],
)
def test_obeys_the_contract(tmp_path: Path, names: list[str]) -> None:
    dataset = registry.open_dataset(write(tmp_path, names), "folder")
    check_dataset(dataset)
    np.testing.assert_array_equal(dataset.frame(1).depth, ramp(1))
    assert dataset.frame(1).depth.dtype == np.uint16
    assert (dataset.intrinsics.fx, dataset.intrinsics.cy) == (30.0, 11.5)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["depth/9.5.png", "depth/10.25.png"], [9.5, 10.25]),
        (["1628069033660061000.png", "1628069034000000000.png"], [1628069033.660061, 1628069034]),
        (["depth/img9.png", "depth/img10.png"], [0.9, 1.0]),
        (["depth/one.png", "depth/two.png"], [0.0, 0.1]),
        (["depth/1617685268177380.png", "depth/1617685268210745.png"], NEAR_2021),
        (["depth/1617685268177.png", "depth/1617685268211.png"], [1617685268.177, 1617685268.211]),
        (["depth/1617685268.png", "depth/1617685269.png"], [1617685268.0, 1617685269.0]),
        (["depth/depth_1617685268.17738.png", "depth/depth_1617685268.210745.png"], NEAR_2021),
        (["depth/1617685268210745_depth.png", "depth/1617685268177380_depth.png"], NEAR_2021),
        (["depth/d455_Depth_1617685268177.38.png", "depth/d455_Depth_1617685268210.745.png"],
         NEAR_2021),
        (["depth/_Depth_9990.5.png", "depth/_Depth_10023.5.png"], [9.9905, 10.0235]),
        (["depth/1617685268_177380000.png", "depth/1617685268_210745000.png"], NEAR_2021),
        (["depth/1617685268-998.png", "depth/1617685269-031.png"],
         [1617685268.998, 1617685269.031]),
        (["depth/1617685268_000008.png", "depth/1617685268_000009.png"], [0.8, 0.9]),
        (["depth/cam1_frame9_z16.png", "depth/cam1_frame10_z16.png"], [0.9, 1.0]),
        (["depth/2021-04-06_05-01-08.998.png", "depth/2021-04-06_05-01-09.031.png"],
         [1617685268.998, 1617685269.031]),
        (["depth/20210406_050108.png", "depth/20210406_050109.png"], [1617685268.0, 1617685269.0]),
        (["depth/2021-04-06_05-01-08_000008.png", "depth/2021-04-06_05-01-08_000009.png"],
         [0.8, 0.9]),
        (["depth/0000000008.png", "depth/0000000009.png"], [0.8, 0.9]),
    ],
)  # fmt: skip
def test_times_come_from_names(tmp_path: Path, names: list[str], expected: list[float]) -> None:
    assert stamps(write(tmp_path, names, fps=10)) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize("units_per_s", [1e3, 1e6, 1e9])
def test_the_unit_of_listed_times_is_told_by_magnitude(tmp_path: Path, units_per_s: float) -> None:
    folder = write(tmp_path, ["depth/1.png", "depth/2.png"])
    lines = [f"{round(stamp_s * units_per_s)}\n" for stamp_s in (1617685268.177, 1617685268.211)]
    (folder / "timestamps.txt").write_text("".join(lines))
    assert stamps(folder) == pytest.approx([1617685268.177, 1617685268.211], abs=1e-6)


def test_true_poses_of_another_clock_are_told(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    folder = write(tmp_path, ["depth/1.png", "depth/2.png"])
    write_tum(folder / "groundtruth.txt", trajectory([1000.0, 1000.1]))
    assert registry.open_dataset(folder).groundtruth() is None
    assert (
        "groundtruth.txt: no pose near 2 of 2 frames (poses from 1000.000 to 1000.100 s, frames "
        "from 0.033 to 0.067 s)"
    ) in caplog.text
    (folder / "groundtruth.txt").write_text("# nothing was recorded\n")
    assert registry.open_dataset(folder).groundtruth() is None
    assert "groundtruth.txt: no pose near 2 of 2 frames\n" in caplog.text


def test_times_come_from_a_list(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = write(tmp_path, ["depth/1.png", "depth/2.png", "depth/3.png"])
    (folder / "timestamps.txt").write_text("# s\n5.0\n5.5\n6.0\n")
    assert stamps(folder) == [5.0, 5.5, 6.0]
    (folder / "timestamps.txt").write_text("3.png 1.0\n1 2.0\n")
    assert stamps(folder) == [1.0, 2.0]
    assert registry.open_dataset(folder).frame(0).depth[0, 1] == 3001
    assert "found times of 2 of the 3 images" in caplog.text
    (folder / "timestamps.txt").write_text("1.0\n2.0\n")
    assert "timestamps.txt: found 2 times, expected 3" in refusal("folder", folder)
    (folder / "timestamps.txt").write_text("1.0\n2.0\n2.0\n")
    assert "timestamps.txt: found frame 2 at 2.000000 s after 2.0" in refusal("folder", folder)
    (folder / "timestamps.txt").write_text("1.png nan\n")
    assert "found nan as time of frame 0" in refusal("folder", folder)
    (folder / "timestamps.txt").write_text("now\n")
    assert "timestamps.txt, line 1: found 'now', expected seconds" in refusal("folder", folder)


def test_scales_are_exact(tmp_path: Path) -> None:
    folder = write(tmp_path, ["depth/0.png", "depth/1.npy"], depth_scale=4000)
    np.save(folder / "depth" / "2.npy", np.full((HEIGHT, WIDTH), 6000.0, np.float64))
    dataset = registry.open_dataset(folder)
    for index in (0, 1):
        expected = (ramp(index) / 4000).astype(np.float32)
        np.testing.assert_array_equal(dataset.frame(index).depth, expected)
    assert (dataset.frame(2).depth == np.float32(1.5)).all()


def test_floats_are_metres(tmp_path: Path) -> None:
    folder = write(tmp_path, ["depth/0.png"])
    depth = np.full((HEIGHT, WIDTH), 1.25, np.float32)
    depth[0, :3] = (np.nan, np.inf, -1.0)
    np.save(folder / "depth" / "1.npy", depth)
    assert registry.open_dataset(folder).frame(1).depth_m()[0, :4].tolist() == [0, 0, 0, 1.25]


@pytest.mark.parametrize("name", ["poses.txt", "groundtruth.txt"])
def test_poses_are_matched_by_time(tmp_path: Path, name: str) -> None:
    folder = write(tmp_path, ["depth/1.0.png", "depth/1.04.png", "depth/3.0.png"])
    write_tum(folder / name, trajectory([1.0, 1.08]))
    groundtruth = registry.open_dataset(folder).groundtruth()
    assert groundtruth is not None
    np.testing.assert_allclose(groundtruth.poses[1], pose(1.04), atol=1e-9)
    assert np.isnan(groundtruth.poses[2]).all()


def test_colour_beside_depth(tmp_path: Path) -> None:
    folder = write(tmp_path, ["depth/1.0.png", "depth/2.0.png"])
    write_png(folder / "color" / "1.0.png", np.full((HEIGHT, WIDTH, 3), (0, 0, 9), np.uint8))
    write_png(folder / "color" / "2.0.png", np.zeros((4, 4, 3), np.uint8))
    dataset = registry.open_dataset(folder)
    color = dataset.color(0)
    assert color is not None
    assert color[0, 0].tolist() == [9, 0, 0]
    assert dataset.color(1) is None, "of another size: not registered"
    assert dataset.gray(1) is not None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "intrinsics.json: found no JSON object ("),
        ("[]", "intrinsics.json: found no JSON object (a list), expected a camera"),
        ('{"width": 32}', "key 'height': found none, expected one"),
        (
            json.dumps({**CAMERA, "fx": -1}),
            "found a focal length fx of -1 px for an image of 32x24",
        ),
        (json.dumps({**CAMERA, "depth_scale": 0.001}), "it is units a metre, such as 1000"),
        (json.dumps({**CAMERA, "width": 64}), "found 32x24 pixels, expected 64x24"),
    ],
)
def test_cameras_that_are_none_are_refused(tmp_path: Path, text: str, message: str) -> None:
    folder = write(tmp_path, ["depth/1.png"])
    (folder / "intrinsics.json").write_text(text)
    assert message in refusal("folder", folder)


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((HEIGHT, WIDTH), np.int64), "found an array (24, 32) of int64, expected"),
        (np.zeros((HEIGHT, WIDTH, 1), np.uint16), "found an array (24, 32, 1) of uint16"),
        (np.array([{}]), "found no whole array"),
        (np.zeros((HEIGHT, 5), np.uint16), "found 5x24 pixels, expected 32x24"),
    ],
)
def test_arrays_that_are_no_depth_are_refused(
    tmp_path: Path, array: NDArray[np.generic], message: str
) -> None:
    folder = write(tmp_path, ["depth/1.png"])
    np.save(folder / "depth" / "2.npy", array)
    assert f"2.npy: {message}" in refusal("folder", folder)


def test_cut_arrays_and_missing_files_are_refused(tmp_path: Path) -> None:
    folder = write(tmp_path, ["depth/1.npy"])
    file = folder / "depth" / "1.npy"
    file.write_bytes(file.read_bytes()[:500])
    assert "1.npy: found no whole array" in refusal("folder", folder)
    file.write_bytes(b"")
    assert "1.npy: found no whole array" in refusal("folder", folder)
    file.unlink()
    assert "found no depth images, expected depth/NAME.png" in refusal("folder", folder)
    (folder / "intrinsics.json").unlink()
    assert "intrinsics.json: found no such file, expected JSON" in refusal("folder", folder)


def test_an_unfinished_image_is_no_image(tmp_path: Path) -> None:
    folder = write(tmp_path, ["depth/1.0.png", "depth/.2.0.png"])
    assert stamps(folder) == [1.0]


def test_frames_of_7_scenes_with_a_camera_are_both(tmp_path: Path) -> None:
    folder = write(tmp_path, ["frame-000000.depth.png"])
    with pytest.raises(DatasetError, match="choose by --dataset 7scenes or folder"):
        registry.open_dataset(folder)
    assert registry.open_dataset(folder, "folder").intrinsics.fx == 30.0
    assert registry.open_dataset(folder, "7scenes").intrinsics.fx == 585.0 * WIDTH / 640
