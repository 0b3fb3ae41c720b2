from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, refusal, trajectory, write_png

from slam_bof.core import registry
from slam_bof.geometry import write_tum

STAMPS = ["1305031102.160407", "1305031102.194330", "1305031102.226738", "1305031102.262886"]
TIMES = [float(stamp) for stamp in STAMPS]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four frames of 32x24 pixels with colour of the first two."""
    sequence = tmp_path / "rgbd_dataset_freiburg2_toy"
    for number, stamp in enumerate(STAMPS):
        write_png(sequence / "depth" / f"{stamp}.png", ramp(number))
    lines = "".join(f"{stamp} depth/{stamp}.png\n" for stamp in STAMPS)
    (sequence / "depth.txt").write_text(f"# depth maps\n# timestamp filename\n{lines}")
    image = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    for number in range(2):
        image[:] = (0, 0, 100 + number)  # BGR
        write_png(sequence / "rgb" / f"{number}.png", image)
    (sequence / "rgb.txt").write_text(
        f"{TIMES[0] + 0.015:.6f} rgb/0.png\n{TIMES[1] - 0.004:.6f} rgb/1.png\n"
    )
    return sequence


def write_poses(folder: Path, since_s: list[float]) -> None:
    """Write ground truth at times since the first frame."""
    found = trajectory(since_s)
    found.stamps_s[:] += TIMES[0]
    write_tum(folder / "groundtruth.txt", found)


def test_obeys_the_contract(folder: Path) -> None:
    write_poses(folder, [-0.01, 0.05, 0.2])
    check_dataset(registry.open_dataset(folder))


def test_reads_depth_times_and_the_camera_of_its_freiburg(folder: Path) -> None:
    dataset = registry.open_dataset(folder)
    assert dataset.name == "tum"
    frame = dataset.frame(1)
    assert frame.stamp_s == TIMES[1]
    assert frame.depth.dtype == np.float32
    np.testing.assert_array_equal(frame.depth, (ramp(1) / 5000).astype(np.float32))
    camera = dataset.intrinsics
    expected = np.array([520.9, 521.0, 325.1, 249.7]) * WIDTH / 640
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("name", "which", "published"),
    [
        ("freiburg1_xyz", "color", (517.3, 516.5, 318.6, 255.3)),
        ("freiburg2_desk", "infrared", (580.8, 581.8, 308.8, 253.0)),
        ("freiburg3_office", "color", (535.4, 539.2, 320.1, 247.6)),
        ("freiburg3_office", "default", (525.0, 525.0, 319.5, 239.5)),
        ("my_own", "color", (525.0, 525.0, 319.5, 239.5)),
    ],
)
def test_cameras_as_published(
    tmp_path: Path, name: str, which: str, published: tuple[float, ...]
) -> None:
    folder = tmp_path / name
    write_png(folder / "depth" / "1.png", np.ones((480, 640), np.uint16))
    (folder / "depth.txt").write_text("1.0 depth/1.png\n")
    camera = registry.open_dataset(folder, "tum", {"camera": which}).intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == published


def test_a_camera_of_ones_own(folder: Path) -> None:
    camera = registry.open_dataset(folder, "auto", {"intrinsics": [31, 32, 13, 14]}).intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (31, 32, 13, 14)
    assert refusal("tum", folder, intrinsics=[31, 32, 130, 14]).startswith(
        "dataset.options.intrinsics: found the principal point at cx = 130 px"
    )


def test_saturated_depth_is_missing(folder: Path) -> None:
    depth = ramp()
    depth[1, 1] = 65535
    write_png(folder / "depth" / f"{STAMPS[0]}.png", depth)
    assert registry.open_dataset(folder).frame(0).depth_m()[:2, :2].ravel().tolist() == [
        0.0,
        pytest.approx(1001 / 5000),
        pytest.approx(1032 / 5000),
        0.0,
    ]


def test_colour_is_the_nearest_in_time(folder: Path) -> None:
    dataset = registry.open_dataset(folder)
    seen = [dataset.color(i) for i in range(4)]
    assert seen[0] is not None
    assert seen[1] is not None
    assert seen[0][0, 0].tolist() == [100, 0, 0]
    assert seen[1][0, 0].tolist() == [101, 0, 0]
    assert seen[2:] == [None, None]
    gray = dataset.gray(0)
    assert gray is not None
    assert gray.shape == (HEIGHT, WIDTH)


def test_truth_is_interpolated_and_a_frame_without_stays(folder: Path) -> None:
    # Frames at 0, 34, 66 and 102 ms; nothing is recorded between 40 and 180 ms.
    write_poses(folder, [0.0, 0.02, 0.04, 0.18])
    dataset = registry.open_dataset(folder)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    assert len(groundtruth) == len(dataset) == 4
    np.testing.assert_allclose(groundtruth.poses[0], pose(0.0), atol=1e-9)
    np.testing.assert_allclose(groundtruth.poses[1], pose(TIMES[1] - TIMES[0]), atol=1e-6)
    assert np.isnan(groundtruth.poses[2:]).all()


def test_truth_of_another_time_is_none(folder: Path) -> None:
    write_poses(folder, [500.0, 500.01])
    assert registry.open_dataset(folder).groundtruth() is None


def test_listed_images_that_are_not_there_are_left_out(
    folder: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (folder / "depth" / f"{STAMPS[1]}.png").unlink()
    dataset = registry.open_dataset(folder)
    assert [dataset.frame(i).stamp_s for i in range(3)] == [TIMES[0], *TIMES[2:]]
    assert f"1 of 4 listed depth images are not there, the first {STAMPS[1]}.png" in caplog.text
    for file in (folder / "depth").iterdir():
        file.unlink()
    assert "found 4 images listed and none of them there" in refusal("tum", folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("2.0 depth/a.png\n1.0 depth/b.png\n", "depth.txt: found frame 1 at 1.000000 s after 2.0"),
        ("soon depth/a.png\n", "depth.txt, line 1: found 'soon depth/a.png', expected a stamp"),
        ("1.0\n", "depth.txt, line 1: found '1.0', expected a stamp and a file"),
        ("1.0 ../../secret.png\n", "expected a file below the sequence"),
        ("1.0 /etc/passwd\n", "expected a file below the sequence"),
        ("# nothing\n", "found 0 images listed"),
    ],
)
def test_lists_that_are_none_are_refused(folder: Path, text: str, message: str) -> None:
    (folder / "depth.txt").write_text(text)
    assert message in refusal("tum", folder)


def test_images_that_are_no_depth_are_refused(folder: Path) -> None:
    file = folder / "depth" / f"{STAMPS[2]}.png"
    write_png(file, ramp()[:12])
    assert f"{file}: found 32x12 pixels, expected 32x24" in refusal("tum", folder)
    write_png(file, ramp().astype(np.uint8))
    assert f"{file}: found a PNG of 8 bits" in refusal("tum", folder)


def test_poses_that_are_none_are_refused(folder: Path) -> None:
    (folder / "groundtruth.txt").write_text("1305031102.1 0 0 0 0 0 0 2\n")
    assert "groundtruth.txt, line 1: found a quaternion of norm 2" in refusal("tum", folder)
    (folder / "depth.txt").unlink()
    assert "depth.txt: found no such file, expected lines of stamp" in refusal("tum", folder)


def test_the_real_excerpt_reads(shared_data: Path, caplog: pytest.LogCaptureFixture) -> None:
    folder = shared_data / "tum" / "rgbd_dataset_freiburg1_xyz_excerpt"
    dataset = registry.open_dataset(folder)
    check_dataset(dataset)
    assert (dataset.name, len(dataset)) == ("tum", 18)
    assert "981 of 999 listed depth images are not there" in caplog.text
    depth_m = dataset.frame(9).depth_m()
    assert 0.5 < np.median(depth_m[depth_m > 0]) < 2.0
