"""Files that readers of data sets must refuse: implausible, endless, or fatal to a library."""

from __future__ import annotations

import io
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, refusal
from scipy.io import savemat
from test_dataset_scannet import HEADER_BYTES, write_sens
from test_dataset_sunrgbd import write_split

from slam_bof.core import registry
from slam_bof.datasets import FramePoseSynchroniser, read_depth_image
from slam_bof.errors import DatasetError
from slam_bof.geometry import read_kitti, read_tum
from slam_bof.types import DepthFrame, Intrinsics

CAMERA = {"width": WIDTH, "height": HEIGHT, "fx": 30, "fy": 30, "cx": 16, "cy": 12}


def npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def folder_of(tmp_path: Path, image: bytes) -> Path:
    (tmp_path / "depth").mkdir(exist_ok=True)
    (tmp_path / "intrinsics.json").write_text(json.dumps(CAMERA))
    (tmp_path / "depth" / "0.npy").write_bytes(image)
    return tmp_path


WHOLE = npy(np.full((HEIGHT, WIDTH), 1500, np.uint16))
ARRAYS = {
    "cut in its header": WHOLE[:40],
    "cut in its data": WHOLE[:-1],
    "with more than its data": WHOLE + b"\0",
    "a header that does not end": WHOLE[:10] + b"{'descr': ('<u2', " + b" " * 100,
    "a header of brackets": b"\x93NUMPY\x01\0\x10\x27" + b"[" * 10000,
    "terabytes": WHOLE.replace(b"(24, 32)", b"(9999999, 9999999)"),
    "negative": WHOLE.replace(b"(24, 32)", b"(-24, 32)"),
    "objects": WHOLE.replace(b"'<u2'", b"'|O'"),
    "empty": b"",
    "text": npy(np.array([["a"] * WIDTH] * HEIGHT)),
    "1e35 m": npy(np.full((HEIGHT, WIDTH), 1e35, np.float32)),
}


@pytest.mark.parametrize("case", ARRAYS)
def test_arrays_that_are_no_depth_are_refused(tmp_path: Path, case: str) -> None:
    folder = folder_of(tmp_path, ARRAYS[case])
    image = folder / "depth" / "0.npy"
    with pytest.raises(DatasetError, match=r"0\.npy: found ") as caught:
        registry.open_dataset(folder, "folder").frame(0)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    with pytest.raises(DatasetError, match=r"0\.npy: found "):
        read_depth_image(image, intrinsics=(30, 30, 16, 12))


def test_a_pixel_that_stands_for_something_else_is_missing(tmp_path: Path) -> None:
    depth_m = np.full((HEIGHT, WIDTH), 1.5)
    depth_m[0, :3] = (1e35, 1e300, np.nan)
    frame = registry.open_dataset(folder_of(tmp_path, npy(depth_m)), "folder").frame(0)
    assert frame.depth_m()[0, :4].tolist() == [0.0, 0.0, 0.0, 1.5]


SENS = {
    "fx inf": (12 + 4 + 2 * 64, "<f", np.inf),
    "fx 1e-38": (12 + 4 + 2 * 64, "<f", 1e-38),
    "fx 1e38": (12 + 4 + 2 * 64, "<f", 1e38),
    "cx NaN": (12 + 4 + 2 * 64 + 8, "<f", np.nan),
    "units inf": (HEADER_BYTES - 12, "<f", np.inf),
    "units NaN": (HEADER_BYTES - 12, "<f", np.nan),
    "units 1e-30": (HEADER_BYTES - 12, "<f", 1e-30),
    "width 2^32": (HEADER_BYTES - 20, "<I", 2**32 - 1),
    "frames 2^64": (HEADER_BYTES - 8, "<Q", 2**64 - 1),
}


@pytest.mark.parametrize("case", SENS)
def test_implausible_headers_of_sens_files_are_refused(tmp_path: Path, case: str) -> None:
    path = write_sens(tmp_path / "a.sens")
    at, form, value = SENS[case]
    data = bytearray(path.read_bytes())
    struct.pack_into(form, data, at, value)
    path.write_bytes(data)
    assert "a.sens" in refusal("scannet", path)


def test_a_pose_at_the_end_of_the_universe_is_unknown(tmp_path: Path) -> None:
    path = write_sens(tmp_path / "a.sens")
    data = bytearray(path.read_bytes())
    struct.pack_into("<f", data, HEADER_BYTES + 3 * 4, 1e38)
    path.write_bytes(data)
    groundtruth = registry.open_dataset(path).groundtruth()
    assert groundtruth is not None
    assert np.isnan(groundtruth.poses[0]).all()
    tum, kitti = tmp_path / "t.tum", tmp_path / "k.txt"
    tum.write_text("0 1e38 0 0 0 0 0 1\n")
    kitti.write_text("1 0 0 1e38 0 1 0 0 0 0 1 0\n")
    for read, file in ((read_tum, tum), (read_kitti, kitti)):
        try:
            assert np.isnan(read(file).poses).all()
        except DatasetError as error:
            assert "expected metres" in str(error)  # noqa: PT017


@pytest.mark.parametrize(
    "text", ["[" * 100_000, '{"width": 1e999}', "null", '{"width": "x"}', '{"depth_scale": NaN}']
)
def test_camera_files_of_anything_are_refused(tmp_path: Path, text: str) -> None:
    folder = folder_of(tmp_path, WHOLE)
    (folder / "intrinsics.json").write_text(text)
    assert "intrinsics.json" in refusal("folder", folder)
    with pytest.raises(DatasetError, match=r"intrinsics\.json: found"):
        read_depth_image(folder / "depth" / "0.npy", camera_file=folder / "intrinsics.json")


def test_names_that_no_file_can_have_are_of_missing_files(tmp_path: Path) -> None:
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth.txt").write_text(f"0.0 depth/{'x' * 3000}.png\n")
    message = refusal("tum", tmp_path)
    assert "1 images listed and none of them there" in message
    assert len(message) < 500
    for line in (f"0.0 ../{'x' * 3000}", "y" * 3000):
        (tmp_path / "depth.txt").write_text(line)
        assert len(refusal("tum", tmp_path)) < 500
    with pytest.raises(DatasetError, match="found no such file"):
        read_depth_image(tmp_path / ("y" * 3000))


def test_a_picture_of_a_billion_pixels_is_not_decoded(tmp_path: Path) -> None:
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR" + struct.pack(">2I5B", 60_000, 60_000, 16, 0, 0, 0, 0)
    (tmp_path / "x.png").write_bytes(png)
    with pytest.raises(DatasetError, match=r"x\.png: found no image that can be read"):
        read_depth_image(tmp_path / "x.png", intrinsics=(30, 30, 16, 12))


def test_a_split_that_kills_its_reader_is_refused(tmp_path: Path) -> None:
    """SciPy 1.17 reads beyond its memory in this file, and the interpreter ends by signal 11."""
    (tmp_path / "SUNRGBD" / "kv1").mkdir(parents=True)
    file = write_split(tmp_path, [], [])
    names = np.array([f"/n/fs/sun3d/data/SUNRGBD/kv1/NYUdata/NYU{k:04d}" for k in (0, 1)], object)
    savemat(file, {"alltrain": names, "alltest": names[:1]})
    data = bytearray(file.read_bytes())
    data[295], data[336] = 77, 127
    file.write_bytes(data)
    assert "allsplit.mat: found " in refusal("sunrgbd", tmp_path)


def test_a_frame_without_a_time_is_refused_at_the_door() -> None:
    depth, camera = np.ones((3, 4), np.uint16), Intrinsics(4, 3, 4.0, 4.0, 2.0, 1.5)
    synchroniser = FramePoseSynchroniser()
    taken = 0
    for index in range(60):
        if index == 20:
            for stamp_s in (np.nan, np.inf):
                with pytest.raises(ValueError, match="a frame's stamp must be finite"):
                    synchroniser.add_frame(DepthFrame(stamp_s, depth, camera))
        synchroniser.add_frame(DepthFrame(index / 30, depth, camera))
        if index >= 2:
            synchroniser.add_pose((index - 2) / 30, np.eye(4))
        taken += len(synchroniser.take())
    assert taken == 58
