from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, refusal

from slam_bof.core import registry
from slam_bof.errors import DatasetError

N_FRAMES = 4
HEADER_BYTES = 12 + 4 + 4 * 64 + 2 * 4 + 4 * 4 + 4 + 8


def camera(fx: float, fy: float, cx: float, cy: float) -> bytes:
    K = np.eye(4, dtype="<f4")
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = fx, fy, cx, cy
    return K.tobytes()


def write_sens(
    path: Path,
    *,
    version: int = 4,
    units_per_m: float = 1000.0,
    depth_coding: int = 1,
    stamps_us: list[int] | None = None,
    lost: tuple[int, ...] = (),
    lost_as: float = -np.inf,
    with_color: bool = True,
) -> Path:
    """Four frames of ramps; colour of twice the size, its left half red."""
    times = stamps_us or [5_000_000 + 33_333 * i for i in range(N_FRAMES)]
    eye = np.eye(4, dtype="<f4").tobytes()
    image = np.zeros((2 * HEIGHT, 2 * WIDTH, 3), np.uint8)
    image[:, :WIDTH] = (0, 0, 255)
    jpeg = cv2.imencode(".jpg", image)[1].tobytes() if with_color else b""
    parts = [
        struct.pack("<IQ", version, 4),
        b"Toys",
        camera(60, 60, 32, 24),
        eye,
        camera(30, 31, 16, 12),
        eye,
        struct.pack("<2i", 2, depth_coding),
        struct.pack("<4I", 2 * WIDTH, 2 * HEIGHT, WIDTH, HEIGHT),
        struct.pack("<fQ", units_per_m, N_FRAMES),
    ]
    for number in range(N_FRAMES):
        T = pose(number).astype("<f4")
        if number in lost:
            T[:] = lost_as
        depth = ramp(number).astype("<u2").tobytes()
        depth = zlib.compress(depth) if depth_coding == 1 else depth
        parts += [T.tobytes(), struct.pack("<4Q", 1, times[number], len(jpeg), len(depth))]
        parts += [jpeg, depth]
    parts.append(struct.pack("<Q", 0))  # frames of the inertial sensor
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"".join(parts))
    return path


@pytest.mark.parametrize("options", [{}, {"depth_coding": 0, "lost": (1,)}])
def test_obeys_the_contract(tmp_path: Path, options: dict[str, object]) -> None:
    check_dataset(registry.open_dataset(write_sens(tmp_path / "a.sens", **options)))


def test_reads_what_was_written(tmp_path: Path) -> None:
    folder = write_sens(tmp_path / "scene0000_00" / "scene0000_00.sens", lost=(2,)).parent
    dataset = registry.open_dataset(folder)
    assert (dataset.name, len(dataset)) == ("scannet", N_FRAMES)
    assert dataset.sequence == "scene0000_00/scene0000_00"
    camera = dataset.intrinsics
    assert (camera.width, camera.height) == (WIDTH, HEIGHT)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30, 31, 16, 12)
    frame = dataset.frame(3)
    assert frame.stamp_s == pytest.approx(5.099999, abs=1e-9)
    assert frame.depth.dtype == np.uint16
    np.testing.assert_array_equal(frame.depth, ramp(3))
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    known = np.isfinite(groundtruth.poses).all(axis=(1, 2))
    assert known.tolist() == [True, True, False, True]
    np.testing.assert_allclose(groundtruth.poses[3], pose(3), atol=1e-6)
    assert np.isnan(groundtruth.poses[2]).all()


def test_a_pose_of_zeros_is_unknown(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_sens(tmp_path / "a.sens", lost=(1,), lost_as=0.0)
    groundtruth = registry.open_dataset(path).groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses).all(axis=(1, 2)).tolist() == [False, True, False, False]
    assert "1 of 4 poses are unknown or left out; the first: frame 1: found a matrix" in caplog.text


def test_colour_is_brought_to_depth(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "a.sens")
    dataset = registry.open_dataset(path)
    color, gray = dataset.color(1), dataset.gray(1)
    assert color is not None
    assert gray is not None
    assert color.shape == (HEIGHT, WIDTH, 3)
    assert (color[:, : WIDTH // 2 - 2, 0] > 200).all()
    assert (color[:, WIDTH // 2 + 2 :, 0] < 50).all()
    assert gray.shape == (2 * HEIGHT, 2 * WIDTH)


def test_without_colour_there_is_none(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    dataset = registry.open_dataset(write_sens(tmp_path / "a.sens", with_color=False))
    assert dataset.color(0) is None
    assert "a.sens: colour image 0 cannot be read" in caplog.text


def test_other_units_become_metres(tmp_path: Path) -> None:
    dataset = registry.open_dataset(write_sens(tmp_path / "a.sens", units_per_m=4000.0))
    np.testing.assert_array_equal(dataset.frame(0).depth, (ramp() / 4000).astype(np.float32))


def test_times_that_do_not_grow_are_counted(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    dataset = registry.open_dataset(write_sens(tmp_path / "a.sens", stamps_us=[0] * 4))
    assert dataset.frame(3).stamp_s == pytest.approx(0.1)
    assert "times do not grow; taking 30 frames a second" in caplog.text


def test_lost_everywhere_is_no_truth(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "a.sens", lost=(0, 1, 2, 3))
    assert registry.open_dataset(path).groundtruth() is None


@pytest.mark.parametrize(
    ("n_bytes", "message"),
    [
        (0, "found the end of the file in the header"),
        (10, "found the end of the file in the header"),
        (100, "found the end of the file in the header"),
        (HEADER_BYTES, f"found {HEADER_BYTES} bytes, expected 4 frames: truncated"),
        (-1000, "which end in frame 3, expected 4 frames: truncated"),
        (-9, "which end in frame 3, expected 4 frames: truncated"),
    ],
)
def test_truncated_files_are_refused(tmp_path: Path, n_bytes: int, message: str) -> None:
    path = write_sens(tmp_path / "a.sens")
    path.write_bytes(path.read_bytes()[:n_bytes])
    assert f"{path}: found" in refusal("scannet", path)
    assert message in refusal("scannet", path)


def test_a_header_of_nonsense_reserves_no_memory(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "a.sens")
    data = bytearray(path.read_bytes())
    data[HEADER_BYTES - 8 : HEADER_BYTES] = struct.pack("<Q", 2**60)
    path.write_bytes(data)
    assert f"expected {2**60} frames: truncated" in refusal("scannet", path)


def test_damage_in_one_frame_is_told_when_it_is_read(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "a.sens", with_color=False)
    data = path.read_bytes()
    at = data.index(zlib.compress(ramp(2).astype("<u2").tobytes()))
    path.write_bytes(data[: at + 5] + b"\0\0\0\0" + data[at + 9 :])
    dataset = registry.open_dataset(path)
    with pytest.raises(DatasetError, match=r"a\.sens: frame 2: found "):
        dataset.frame(2)
    dataset.frame(3)


@pytest.mark.parametrize(
    ("write", "message"),
    [
        (lambda path: write_sens(path, version=3), "found version 3, expected a .sens file"),
        (lambda path: write_sens(path, depth_coding=2), "found depth coded as occi_ushort"),
        (lambda path: write_sens(path, units_per_m=0.0), "and 0.0 units a metre, expected"),
        (lambda path: path.write_bytes(b"\x89PNG" * 99), "expected a .sens file of version 4"),
        (lambda path: path.write_bytes(b"\4\0\0\0" + b"PNG" * 99), "found a name of 5"),
    ],
)
def test_other_files_are_refused(
    tmp_path: Path, write: Callable[[Path], object], message: str
) -> None:
    path = tmp_path / "a.sens"
    write(path)
    assert message in refusal("scannet", path)


def test_one_scan_is_expected(tmp_path: Path) -> None:
    assert "found no .sens file, expected one .sens file" in refusal("scannet", tmp_path)
    for name in "ab":
        write_sens(tmp_path / f"{name}.sens")
    assert "found a.sens, b.sens, expected one .sens file" in refusal("scannet", tmp_path)
