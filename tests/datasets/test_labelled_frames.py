from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam_bof.datasets import (
    LabelledFrame,
    frames_of,
    has_groups,
    open_labelled,
    parse_label,
    read_image_table,
    read_label_file,
    read_split,
)
from slam_bof.datasets.depth_images import DepthImages
from slam_bof.errors import DatasetError
from slam_bof.scenes import frame_groups


def write_sequence(folder: Path, n: int = 3) -> Path:
    folder.mkdir(parents=True)
    for number in range(n):
        depth = np.full((6, 8), 1000 + number, np.uint16)
        cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), depth)
    return folder


def test_names_and_paths() -> None:
    assert parse_label("living room=a/b=c") == ("living room", Path("a/b=c"))
    for text in ("kitchen", "=path", "kitchen=", ""):
        with pytest.raises(DatasetError, match="expected NAME=PATH"):
            parse_label(text)


def test_a_folder_of_sequences_is_all_of_them(tmp_path: Path) -> None:
    for name in ("seq-01", "seq-02"):
        write_sequence(tmp_path / "kitchen" / name)
    found = open_labelled("kitchen", tmp_path / "kitchen")
    assert [s.dataset.sequence for s in found] == ["kitchen/seq-01", "kitchen/seq-02"]
    chosen = frames_of(found, every=2)
    assert [(f.index, f.label) for f in chosen] == [(0, "kitchen"), (2, "kitchen")] * 2


def test_labels_of_its_own(tmp_path: Path) -> None:
    folder = write_sequence(tmp_path / "seq-01")
    with pytest.raises(DatasetError, match="found no scene labels there, expected NAME=PATH"):
        open_labelled(None, folder)
    (folder / "scenes.csv").write_text("frame,scene\n0,hall\n1,\n2,bath\n")
    assert [f.label for f in frames_of(open_labelled(None, folder))] == ["hall", "bath"]
    assert {f.label for f in frames_of(open_labelled("all", folder))} == {"all"}


def test_images_without_a_camera_are_told_what_is_missing(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "1.png"), np.full((6, 8), 1000, np.uint16))
    with pytest.raises(DatasetError, match=r"no intrinsics.json beside them, expected one with"):
        open_labelled("bath", tmp_path)


def test_a_table_of_sequences_and_images(tmp_path: Path) -> None:
    write_sequence(tmp_path / "a" / "seq-01")
    images = write_sequence(tmp_path / "loose")
    table = tmp_path / "labels.csv"
    table.write_text(
        "path,label\na/seq-01,office\nloose/frame-000000.depth.png,bath\n\n"
        "loose/frame-000002.depth.png,bath\nloose/frame-000001.depth.png,hall\n"
    )
    office, bath, hall = read_label_file(table)
    assert (office.label, len(office.dataset)) == ("office", 3)
    assert (bath.label, len(bath.dataset), bath.dataset.sequence) == ("bath", 2, "loose")
    assert [bath.dataset.frame(k).stamp_s for k in (0, 1)] == [0.0, 2 / 30]
    assert bath.dataset.frame(1).depth[0, 0] == 1002
    assert (hall.label, len(hall.dataset)) == ("hall", 1)
    assert images.is_dir()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "found no rows, expected path,label"),
        ("path,label\n", "found no rows, expected path,label"),
        ("none,bath\n", ":1: found no 'none', expected a sequence or image"),
        ("path,label\nx\n", ":2: found 'x', expected path,label"),
        ("x,\n", ":1: found 'x,', expected path,label"),
        ("x" * 9000 + ",bath\n", f":1: found no '{'x' * 200}', expected a sequence or image"),
    ],
)
def test_tables_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    table = tmp_path / "labels.csv"
    table.write_text(text)
    with pytest.raises(DatasetError, match=message):
        read_label_file(table)


def test_a_table_that_is_none(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="expected CSV with path,label"):
        read_label_file(tmp_path / "none.csv")
    (tmp_path / "binary.csv").write_bytes(bytes(range(200, 256)))
    with pytest.raises(DatasetError, match="expected CSV with path,label"):
        read_label_file(tmp_path / "binary.csv")


def test_moments_are_stretches_of_a_sequence_or_whole_sequences(tmp_path: Path) -> None:
    images = [tmp_path / f"{k:03d}.png" for k in range(10)]
    for file in images:
        cv2.imwrite(str(file), np.full((6, 8), 1000, np.uint16))
    one = DepthImages(images)
    many = [DepthImages(images[:2]) for _ in range(5)]
    frames = [LabelledFrame(one, k, "hall") for k in range(10)]
    found = frame_groups(frames + [LabelledFrame(d, k, "bath") for d in many for k in range(2)])
    name = f"0 {tmp_path.name} hall"
    assert found[:10] == [f"{name} {k // 2}" for k in range(10)]
    assert len(set(found[10:])) == 5
    assert found[10::2] == found[11::2]


def test_official_splits(tmp_path: Path) -> None:
    for name in ("seq-01", "seq-2", "seq-03"):
        (tmp_path / name).mkdir()
    (tmp_path / "TrainSplit.txt").write_text("sequence1\nsequence2\nsequence14\n")
    assert [f.name for f in read_split(tmp_path, "TrainSplit.txt")] == ["seq-01", "seq-2"]
    with pytest.raises(DatasetError, match=r"TestSplit.txt: found no such file"):
        read_split(tmp_path, "TestSplit.txt")
    (tmp_path / "TestSplit.txt").write_text("nothing\n")
    with pytest.raises(DatasetError, match="found no sequences, expected lines such as sequence1"):
        read_split(tmp_path, "TestSplit.txt")
    (tmp_path / "TestSplit.txt").write_text("sequence" + "9" * 5000)
    with pytest.raises(DatasetError, match="found no sequences"):
        read_split(tmp_path, "TestSplit.txt")
    (tmp_path / "TestSplit.txt").write_text("sequence7\n")
    with pytest.raises(DatasetError, match=r"found none of seq-07, which TestSplit.txt names"):
        read_split(tmp_path, "TestSplit.txt")


CAMERA_8_BIT = {
    "width": 8, "height": 6, "fx": 9.0, "fy": 9.0, "cx": 4.0, "cy": 3.0,
    "depth_scale": 25.0, "depth_offset": 0.5,
}  # fmt: skip


def write_table(folder: Path, text: str, depth: int = 50) -> Path:
    cv2.imwrite(str(folder / "1.png"), np.full((6, 8), depth, np.uint8))
    (folder / "camera.json").write_text(json.dumps(CAMERA_8_BIT))
    (folder / "labels.csv").write_text(text)
    return folder / "labels.csv"


def test_a_table_of_images_by_group(tmp_path: Path) -> None:
    turned = ",0,1,0,-1,0,0,0,0,1"
    columns = ",".join(["file", "scene_type", "group", *(f"R{k // 3}{k % 3}" for k in range(9))])
    table = write_table(tmp_path, f"{columns}\n1.png,bath,a{turned}\n1.png,hall,b{turned}\n")
    assert has_groups(table)
    bath, hall = read_image_table(table, camera_file=tmp_path / "camera.json")
    assert (bath.label, bath.group, hall.label, hall.group) == ("bath", "a", "hall", "b")
    assert bath.gravity_camera == (-1.0, 0.0, 0.0)
    frame, _ = bath.read(gray=False)
    assert frame.depth_m()[2, 3] == pytest.approx(50.5 / 25.0)
    assert frame.intrinsics.fx == 9.0
    assert frame_groups([bath] * 10 + [hall]) == ["group a"] * 10 + ["group b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "file,scene\n1.png,bath\n",
            "found columns 'file, scene', expected columns file, scene, g",
        ),
        ("file,scene,group\n", "found no rows"),
        ("file,scene,group\n1.png,bath,\n", ":2: found '1.png,bath,', expected"),
        ("file,scene,group\n2.png,bath,a\n", ":2: found no '2.png', expected a depth image"),
        (f"file,scene,group\n{'x' * 9000},bath,a\n", f":2: found no '{'x' * 200}', expected"),
        (f"file,{'x' * 9000},group\n", f"found columns 'file, {'x' * 194}', expected"),
        (
            "file,scene,group,R00,R01,R02,R10,R11,R12,R20,R21,R22\n1.png,bath,a,1,0,0,0,1,0,0,0,x\n",
            ":2: found R00 to R22 that are no rotation",
        ),
    ],
)
def test_tables_by_group_that_are_wrong(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DatasetError, match=message):
        read_image_table(write_table(tmp_path, text))


def test_images_of_8_bits_need_the_units_a_metre(tmp_path: Path) -> None:
    table = write_table(tmp_path, "file,scene,group\n1.png,bath,a\n")
    with pytest.raises(DatasetError, match=r"1.png: found an image of 8 bits, expected 16"):
        read_image_table(table)
