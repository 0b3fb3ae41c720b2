from __future__ import annotations

import os
import shutil
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from datasets import check_dataset

from slam_bof import ports
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof_plugins.dataset_7scenes import SevenScenes

WIDTH, HEIGHT, N_FRAMES = 64, 48, 4


def write_frame(folder: Path, number: int, *, depth: object = None, pose: object = None) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    if depth is None:
        depth = np.full((HEIGHT, WIDTH), 1000 + number, np.uint16)
    if pose is None:
        pose = se3.exp(np.array([0, 0.1 * number, 0, number, 0, 0]))
    cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), np.asarray(depth))
    np.savetxt(folder / f"frame-{number:06d}.pose.txt", np.asarray(pose))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A sequence of four small frames."""
    sequence = tmp_path / "office" / "seq-02"
    for number in range(N_FRAMES):
        write_frame(sequence, number)
    return sequence


def refusal(path: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        SevenScenes.open(path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_reads_what_was_written(folder: Path) -> None:
    dataset = SevenScenes.open(folder)
    assert isinstance(dataset, ports.Dataset)
    assert (dataset.sequence, len(dataset)) == ("office/seq-02", N_FRAMES)
    frame = dataset.frame(3)
    assert frame.stamp_s == pytest.approx(3 / 30)
    assert frame.depth.dtype == np.uint16
    assert (frame.depth == 1003).all()
    camera = dataset.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (58.5, 58.5, 32.0, 24.0)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    expected = se3.exp(np.array([0, 0.2, 0, 2, 0, 0]))
    np.testing.assert_allclose(groundtruth.poses[2], expected, atol=1e-12)
    assert dataset.color(0) is None
    assert dataset.scenes() is None


def test_full_size_images_have_the_published_camera(tmp_path: Path) -> None:
    write_frame(tmp_path, 0, depth=np.ones((480, 640), np.uint16))
    camera = SevenScenes.open(tmp_path).intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (585.0, 585.0, 320.0, 240.0)


def test_both_missing_depths_read_as_missing(folder: Path) -> None:
    depth = np.full((HEIGHT, WIDTH), 2000, np.uint16)
    depth[0, 0], depth[0, 1] = 0, 65535
    write_frame(folder, 1, depth=depth)
    assert SevenScenes.open(folder).frame(1).depth_m()[0, :3].tolist() == [0, 0, 2]


def test_frames_keep_their_numbers_where_some_are_missing(folder: Path) -> None:
    (folder / "frame-000001.depth.png").unlink()
    dataset = SevenScenes.open(folder)
    assert [dataset.frame(i).stamp_s * 30 for i in range(3)] == pytest.approx([0, 2, 3])
    assert (dataset.frame(1).depth == 1002).all()


@pytest.mark.parametrize("digits", [0, 4, 7])
def test_numbers_of_any_number_of_digits_are_in_order(tmp_path: Path, digits: int) -> None:
    folder = tmp_path / "seq-01"
    for number in (9, 10, 100):
        pose = np.eye(4)
        pose[0, 3] = number
        write_frame(folder, number, pose=pose)
        for suffix in ("depth.png", "pose.txt"):
            (folder / f"frame-{number:06d}.{suffix}").rename(
                folder / f"frame-{number:0{digits}d}.{suffix}"
            )
    assert SevenScenes.recognises(folder) == f"frame-{9:0{digits}d}.depth.png"
    dataset = SevenScenes.open(folder)
    assert [dataset.frame(i).depth[0, 0] for i in range(3)] == [1009, 1010, 1100]
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    assert groundtruth.poses[:, 0, 3] == pytest.approx([9, 10, 100])


def test_two_files_of_one_number_are_refused(folder: Path) -> None:
    shutil.copy(folder / "frame-000002.depth.png", folder / "frame-2.depth.png")
    assert (
        "found frame-000002.depth.png and frame-2.depth.png, expected one file for each frame "
        "number"
    ) in refusal(folder)


def test_poses_may_be_missing(folder: Path) -> None:
    (folder / "frame-000001.pose.txt").unlink()
    groundtruth = SevenScenes.open(folder).groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses).all(axis=(1, 2)).tolist() == [False, True, False, False]
    for file in folder.glob("*.pose.txt"):
        file.unlink()
    assert SevenScenes.open(folder).groundtruth() is None


def test_rotations_of_few_digits_become_rotations(folder: Path) -> None:
    rough = np.round(se3.exp(np.array([0.3, 0.2, 0.1, 1, 2, 3])), 3)
    write_frame(folder, 1, pose=rough)
    groundtruth = SevenScenes.open(folder).groundtruth()
    assert groundtruth is not None
    R = groundtruth.poses[1, :3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(groundtruth.poses[1], rough, atol=1e-3)


def test_scene_labels_come_from_the_csv_file(folder: Path) -> None:
    (folder / "scenes.csv").write_text("frame,scene\n" + "".join(f"{i},hall\n" for i in range(4)))
    assert SevenScenes.open(folder).scenes() == ("hall",) * 4
    (folder / "scenes.csv").write_text("frame,scene\n0,hall\n")
    assert "scenes.csv: found KeyError(1), expected columns frame,scene" in refusal(folder)


@pytest.mark.parametrize("suffix", ["png", "jpg"])
def test_colour_is_registered_to_depth(tmp_path: Path, suffix: str) -> None:
    z_mm, x_px = 1300, 400
    write_frame(tmp_path, 0, depth=np.full((480, 640), z_mm, np.uint16))
    image = np.zeros((480, 640, 3), np.uint8)
    # A red line on a wall: where the colour camera, 26 mm to the side, sees depth column 400.
    column = 320 + 525 * ((x_px - 320) / 585 - 0.026 / (z_mm / 1000))
    image[:, round(column) - 3 : round(column) + 4] = (0, 0, 255)
    cv2.imwrite(str(tmp_path / f"frame-000000.color.{suffix}"), image)
    color = SevenScenes.open(tmp_path).color(0)
    assert color is not None
    red = np.flatnonzero(color[240, :, 0] > 128)
    assert red.mean() == pytest.approx(x_px, abs=1)
    assert color[240, x_px, 1] < 60
    assert color[240, x_px, 2] < 60


def test_unreadable_colour_is_no_colour(folder: Path, caplog: pytest.LogCaptureFixture) -> None:
    (folder / "frame-000000.color.png").write_bytes(b"not an image")
    assert SevenScenes.open(folder).color(0) is None
    assert "frame-000000.color.png: colour image cannot be read" in caplog.text


def test_scene_folder_with_one_sequence_is_that_sequence(folder: Path) -> None:
    (folder.parent / "seq-01").mkdir()
    assert SevenScenes.recognises(folder.parent)
    assert SevenScenes.open(folder.parent).sequence == "office/seq-02"


def test_scene_folder_with_several_lists_them(folder: Path) -> None:
    write_frame(folder.parent / "seq-11", 0)
    (folder.parent / "TrainSplit.txt").write_text("sequence2\n")
    (folder.parent / "TestSplit.txt").write_text("sequence1\nsequence11\n")
    message = refusal(folder.parent)
    assert "found 2 sequences (seq-02 train, seq-11 test), expected one" in message


def test_recognises_by_content(folder: Path, tmp_path: Path) -> None:
    assert SevenScenes.recognises(folder)
    (tmp_path / "empty").mkdir()
    assert not SevenScenes.recognises(tmp_path / "empty")
    assert not SevenScenes.recognises(tmp_path / "none")


def test_missing_folder_file_and_unknown_layout(folder: Path, tmp_path: Path) -> None:
    assert refusal(tmp_path / "none").endswith(
        "none: found nothing, expected the folder of a sequence"
    )
    assert "found a file, expected the folder" in refusal(folder / "frame-000000.depth.png")
    assert "expected 7-Scenes layout" in refusal(tmp_path)


def cut(data: bytes) -> bytes:
    return data[: len(data) // 2]


def flip(data: bytes) -> bytes:
    at = data.index(b"IDAT") + 10
    return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (cut, "found a truncated PNG file of "),
        (flip, "found a damaged PNG file, expected a whole one"),
        (lambda _: b"", "found no PNG file, expected a 16-bit grey PNG"),
        (lambda _: b"P5 64 48 255 and so on and on and on", "found no PNG file"),
    ],
)
def test_damaged_depth_is_refused_at_the_start_and_told_of_in_the_middle(
    folder: Path, damage: Callable[[bytes], bytes], message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    file = folder / "frame-000002.depth.png"
    file.write_bytes(damage(file.read_bytes()))
    dataset = SevenScenes.open(folder)
    with pytest.raises(DatasetError, match=r"frame-000002\.depth\.png: ") as caught:
        dataset.frame(2)
    assert message in str(caught.value)
    dataset.frame(3)
    shutil.move(file, folder / "frame-000000.depth.png")
    assert message in refusal(folder)
    assert capfd.readouterr().err == "", "the decoder must not talk to the user"


@pytest.mark.parametrize("number", [0, 2])
@pytest.mark.parametrize(
    ("image", "message"),
    [
        (np.zeros((HEIGHT, WIDTH), np.uint8), "found a PNG of 8 bits, expected depth: 16-bit grey"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint8), "found a PNG in colour, expected depth"),
        (np.zeros((HEIGHT, WIDTH, 3), np.uint16), "found a PNG in colour, expected depth"),
    ],
)
def test_what_is_not_depth_is_refused(
    folder: Path, number: int, image: object, message: str
) -> None:
    write_frame(folder, number, depth=image)
    said = refusal(folder)
    assert f"frame-{number:06d}.depth.png: {message}" in said


def test_frames_of_different_sizes_are_refused(folder: Path) -> None:
    write_frame(folder, 2, depth=np.zeros((24, 32), np.uint16))
    assert "frame-000002.depth.png: found 32x24 pixels, expected 64x48" in refusal(folder)


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        (np.full((4, 4), np.nan), "found NaN or infinity, expected a pose"),
        (np.diag([1, 1, -1, 1]), "found no rigid transform (R R^T is off by 0, det R = -1"),
        (np.diag([2, 2, 2, 1]), "found no rigid transform (R R^T is off by 3"),
        (np.ones((4, 4)), "found no rigid transform"),
        (np.zeros((4, 4)), "found no rigid transform"),
        (np.eye(3), "found 9 numbers, expected 16: a pose"),
        (np.eye(4) + np.diag([1e9], 3), "found a position at 1e+09 m, expected metres"),
    ],
)
def test_what_is_no_pose_is_unknown(
    folder: Path, caplog: pytest.LogCaptureFixture, pose: object, message: str
) -> None:
    write_frame(folder, 2, pose=pose)
    groundtruth = SevenScenes.open(folder).groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses).all(axis=(1, 2)).tolist() == [False, False, True, False]
    assert f"1 of 4 poses are unknown or left out; the first: frame-000002.pose.txt: {message}" in (
        caplog.text
    )


@pytest.mark.parametrize("text", ["", "1 0 0 -1.#IND\n" * 4, "lost\n"])
def test_a_pose_file_without_a_pose_is_of_an_unknown_pose(
    folder: Path, caplog: pytest.LogCaptureFixture, text: str
) -> None:
    (folder / "frame-000001.pose.txt").write_text(text)
    dataset = SevenScenes.open(folder)
    check_dataset(dataset)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses[1]).all()
    assert "frame-000001.pose.txt: " in caplog.text
    for file in folder.glob("*.pose.txt"):
        file.write_text(text)
    assert SevenScenes.open(folder).groundtruth() is None


def test_a_png_of_many_chunks_is_whole(folder: Path) -> None:
    file = folder / "frame-000000.depth.png"
    data = file.read_bytes()
    text = b"tEXtComment\0by hand"
    chunk = struct.pack(">I", len(text) - 4) + text + struct.pack(">I", zlib.crc32(text))
    file.write_bytes(data[:33] + chunk + data[33:] + b"trailing")
    assert (SevenScenes.open(folder).frame(0).depth == 1000).all()


def test_the_real_sequence_reads(shared_data: Path) -> None:
    dataset = SevenScenes.open(shared_data / "7scenes" / "redkitchen")
    assert (dataset.sequence, len(dataset)) == ("redkitchen/seq-01", 1000)
    depth_m = dataset.frame(0).depth_m()
    assert (depth_m > 0).mean() > 0.8
    assert depth_m.max() < 10
    color = dataset.color(0)
    assert color is not None
    assert color.shape == (480, 640, 3)
    groundtruth = dataset.groundtruth()
    assert groundtruth is not None
    assert np.isfinite(groundtruth.poses).all()
    assert "seq-01 test, seq-02 train, seq-03 train, seq-04 test" in refusal(
        shared_data / "7scenes" / "stairs"
    )


def test_a_pipe_is_no_image_and_is_not_waited_for(folder: Path) -> None:
    image, pose = (folder / f"frame-000002.{suffix}" for suffix in ("depth.png", "pose.txt"))
    for file in (image, pose):
        file.unlink()
        os.mkfifo(file)
    dataset = SevenScenes.open(folder)
    with pytest.raises(DatasetError, match=r"frame-000002\.depth\.png: found no such file"):
        dataset.frame(2)
    truth = dataset.groundtruth()
    assert truth is not None
    assert np.isnan(truth.poses).any(axis=(1, 2)).tolist() == [False, False, True, False]
