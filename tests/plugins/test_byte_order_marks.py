"""Text files that an editor of Windows has saved: a byte order mark, and CR LF at line ends."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, check_dataset, pose, ramp, trajectory, write_png

from slam_bof.core import registry
from slam_bof.geometry import read_kitti, read_tum, write_kitti, write_tum
from slam_bof.slam import preset
from slam_bof.slam.config import dump, load

TIMES = [1000.0, 1000.05, 1000.1]
CAMERA = {"width": WIDTH, "height": HEIGHT, "fx": 30.0, "fy": 31.0, "cx": 15.5, "cy": 11.5}


def write_tum_rgbd(folder: Path) -> None:
    for number, stamp_s in enumerate(TIMES):
        write_png(folder / "depth" / f"{stamp_s}.png", ramp(number))
    lines = [f"{stamp_s} depth/{stamp_s}.png\n" for stamp_s in TIMES]
    (folder / "depth.txt").write_text("".join(lines))
    write_tum(folder / "groundtruth.txt", trajectory(TIMES))


def write_folder(folder: Path) -> None:
    for number in range(3):
        write_png(folder / "depth" / f"{number}.png", ramp(number))
    (folder / "intrinsics.json").write_text(json.dumps(CAMERA))
    (folder / "timestamps.txt").write_text("".join(f"{stamp_s}\n" for stamp_s in TIMES))
    write_tum(folder / "poses.txt", trajectory(TIMES))


def write_7scenes(folder: Path) -> None:
    rows = ["frame,scene"]
    for number in range(3):
        write_png(folder / f"frame-{number:06d}.depth.png", ramp(number))
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", pose(number))
        rows.append(f"{number},kitchen")
    (folder / "scenes.csv").write_text("\n".join(rows))


def write_replica(folder: Path) -> None:
    for number in range(3):
        write_png(folder / "results" / f"depth{number:06d}.png", ramp(number))
    np.savetxt(folder / "traj.txt", [pose(number).ravel() for number in range(3)])
    camera = {"w": WIDTH, "h": HEIGHT, **{k: CAMERA[k] for k in ("fx", "fy", "cx", "cy")}}
    (folder / "cam_params.json").write_text(json.dumps({"camera": {**camera, "scale": 6553.5}}))


def save_on_windows(file: Path) -> None:
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes().replace(b"\n", b"\r\n"))


@pytest.mark.parametrize("write", [write_tum_rgbd, write_folder, write_7scenes, write_replica])
def test_every_layout_reads_over_them(write: Callable[[Path], None], tmp_path: Path) -> None:
    write(tmp_path / "plain")
    shutil.copytree(tmp_path / "plain", tmp_path / "windows")
    texts = [f for f in (tmp_path / "windows").rglob("*") if f.suffix in (".txt", ".json", ".csv")]
    assert len(texts) >= 2
    for file in texts:
        save_on_windows(file)
    plain, windows = (registry.open_dataset(tmp_path / name) for name in ("plain", "windows"))
    check_dataset(windows)
    assert windows.intrinsics == plain.intrinsics
    assert windows.scenes() == plain.scenes()
    truths = plain.groundtruth(), windows.groundtruth()
    assert truths[0] is not None
    assert truths[1] is not None
    np.testing.assert_array_equal(truths[0].poses, truths[1].poses)
    assert [windows.frame(i).stamp_s for i in range(3)] == [
        plain.frame(i).stamp_s for i in range(3)
    ]


def test_trajectories_and_configurations_are_read_over_them(tmp_path: Path) -> None:
    write_tum(tmp_path / "tum.txt", trajectory(TIMES))
    write_kitti(tmp_path / "kitti.txt", trajectory(TIMES))
    (tmp_path / "config.yaml").write_text(dump(preset("paper")))
    for name in ("tum.txt", "kitti.txt", "config.yaml"):
        save_on_windows(tmp_path / name)
    assert read_tum(tmp_path / "tum.txt").stamps_s.tolist() == TIMES
    assert len(read_kitti(tmp_path / "kitti.txt")) == 3
    assert load(tmp_path / "config.yaml") == preset("paper")
    for name in ("tum.txt", "kitti.txt"):
        odometry = registry.build("odometry", "recorded", {"file": tmp_path / name})
        assert odometry.params.file == tmp_path / name
