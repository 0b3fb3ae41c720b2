from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from datasets import check_dataset, refusal, write_png
from scipy.io import savemat
from typer.testing import CliRunner

from slam_bof import ports
from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof_plugins.dataset_sunrgbd import SCENES

TRAIN = ["kv1/NYUdata/NYU0001", "kv2/kinect2data/000065_resize", "xtion/sun3ddata/hall/0001"]
TEST = ["realsense/lg/2014_10/2014_10-1", "kv1/NYUdata/NYU0002"]
LABELS = ["bedroom", "office", "corridor", "kitchen", "bedroom"]
SIZES = [(40, 30), (44, 32), (40, 30), (36, 28), (40, 30)]  # width, height
MILLIMETRES = 2345


def store(mm: np.ndarray) -> np.ndarray:
    """Turn millimetres as the toolbox undoes it: left by three bits, around the end."""
    return ((mm << np.uint16(3)) | (mm >> np.uint16(13))).astype(np.uint16)


def write_split(root: Path, train: list[str], test: list[str]) -> Path:
    def cells(names: list[str]) -> np.ndarray:
        found = np.empty((1, len(names)), object)
        found[0] = [f"/n/fs/sun3d/data/SUNRGBD/{name}" for name in names]
        return found

    file = root / "SUNRGBDtoolbox" / "traintestSUNRGBD" / "allsplit.mat"
    file.parent.mkdir(parents=True, exist_ok=True)
    savemat(file, {"alltrain": cells(train), "alltest": cells(test)})
    return file


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Five images of all four sensors, as unpacked from the two archives."""
    for number, (name, label) in enumerate(zip(TRAIN + TEST, LABELS, strict=True)):
        folder = tmp_path / "SUNRGBD" / name
        width, height = SIZES[number]
        mm = np.full((height, width), MILLIMETRES + number, np.uint16)
        mm[0, :3] = (0, 9000, 7999)
        write_png(folder / "depth" / f"{number:07d}.png", store(mm))
        write_png(folder / "depth_bfx" / f"{number:07d}.png", store(mm + np.uint16(1)))
        write_png(folder / "image" / f"{number:07d}.jpg", np.full((height, width, 3), 90, np.uint8))
        (folder / "scene.txt").write_text(label)
        K = [50.0 + number, 0, 20, 0, 51, 15, 0, 0, 1]
        (folder / "intrinsics.txt").write_text(" ".join(map(str, K)) + " \n")
    write_split(tmp_path, TRAIN, TEST)
    return tmp_path


def test_obeys_the_contract(root: Path) -> None:
    check_dataset(registry.open_dataset(root))


@pytest.mark.parametrize("below", [".", "SUNRGBD"])
def test_reads_what_was_written(root: Path, below: str) -> None:
    dataset = registry.open_dataset(root / below)
    assert isinstance(dataset, ports.LabelledImages)
    assert (dataset.name, len(dataset)) == ("sunrgbd", 5)
    assert dataset.scenes() == tuple(LABELS)
    assert dataset.is_train.tolist() == [True, True, True, False, False]
    for number in range(5):
        frame = dataset.frame(number)
        camera = frame.intrinsics
        assert frame.depth.dtype == np.uint16
        assert frame.depth[0, :3].tolist() == [0, 8000, 7999]
        assert (frame.depth[1:] == MILLIMETRES + number).all()
        assert (camera.width, camera.height) == SIZES[number]
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == (50 + number, 51, 20, 15)
    color = dataset.color(1)
    assert color is not None
    assert color.shape == (32, 44, 3)


def test_all_values_survive_the_turn_of_bits(root: Path) -> None:
    mm = np.arange(8001, dtype=np.uint16)[: 30 * 40 * 6].reshape(-1, 40)[:30]
    file = root / "SUNRGBD" / TRAIN[0] / "depth" / "0000000.png"
    write_png(file, store(mm))
    np.testing.assert_array_equal(registry.open_dataset(root).frame(0).depth, mm)


def test_filled_depth_on_demand(root: Path) -> None:
    dataset = registry.open_dataset(root, "sunrgbd", {"depth": "depth_bfx"})
    assert dataset.frame(0).depth[1, 1] == MILLIMETRES + 1


def test_other_scenes_are_left_out(root: Path) -> None:
    (root / "SUNRGBD" / TRAIN[1] / "scene.txt").write_text("idk\n")
    dataset = registry.open_dataset(root)
    assert dataset.scenes() == ("bedroom", "corridor", "kitchen", "bedroom")
    assert dataset.is_train.tolist() == [True, True, False, False]
    everything = registry.open_dataset(root, "auto", {"all_scenes": True}).scenes()
    assert everything is not None
    assert everything[1] == "idk"


def test_the_scenes_are_the_nineteen() -> None:
    assert len(set(SCENES)) == len(SCENES) == 19


def test_images_that_are_not_there_are_left_out(
    root: Path, caplog: pytest.LogCaptureFixture
) -> None:
    write_split(root, [*TRAIN, "kv1/NYUdata/NYU0009"], TEST)
    assert len(registry.open_dataset(root)) == 5
    assert "1 of the 6 images of the split are not there" in caplog.text
    write_split(root, ["kv1/NYUdata/NYU0009"], [])
    assert "found none of the 1 images of the split" in refusal("sunrgbd", root)


def test_split_files_that_are_none_are_refused(root: Path) -> None:
    file = write_split(root, ["somewhere/else"], TEST)
    assert "allsplit.mat: found '/n/fs/sun3d/data/SUNRGBD/somewhere/else'" in refusal(
        "sunrgbd", root
    )
    whole = file.read_bytes()
    for damaged in (b"MATLAB", b"", whole[:200], whole[:-40], bytes(500)):
        file.write_bytes(damaged)
        assert "allsplit.mat: found " in refusal("sunrgbd", root)
    savemat(file, {"alltrain": [1]})
    assert "expected a MATLAB 5 file with alltrain and alltest" in refusal("sunrgbd", root)
    file.unlink()
    assert "found no such file, expected the split of SUNRGBDtoolbox" in refusal("sunrgbd", root)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("scene.txt", "", "scene.txt: found '', expected one word: a scene"),
        ("scene.txt", "two words", "expected one word: a scene"),
        ("intrinsics.txt", "1 2 3", "intrinsics.txt: found [1.0, 2.0, 3.0], expected 9 numbers"),
        ("intrinsics.txt", "0 0 0 0 0 0 0 0 0", "intrinsics.txt: found a focal length fx of 0 px"),
        ("intrinsics.txt", "f", "could not convert string to float: 'f', expected 9 numbers"),
        ("depth/0000000.png", "text", "0000000.png: found no PNG file, expected a 16-bit"),
    ],
)
def test_malformed_images_are_refused(root: Path, name: str, text: str, message: str) -> None:
    (root / "SUNRGBD" / TRAIN[0] / name).write_text(text)
    assert message in refusal("sunrgbd", root)


def test_other_folders_are_refused(tmp_path: Path) -> None:
    (tmp_path / "kv1").mkdir()
    assert "expected SUN RGB-D" in refusal("sunrgbd", tmp_path)


def test_single_images_are_not_run(root: Path) -> None:
    result = CliRunner().invoke(app, ["run", str(root), "-o", str(root / "runs")])
    assert result.exit_code == 1
    assert "found single images of sunrgbd, expected a sequence" in result.stderr
    assert "recognised as sunrgbd: SUNRGBD with kv1/, kv2/, realsense/, xtion/, allsplit.mat" in (
        result.stderr
    )
