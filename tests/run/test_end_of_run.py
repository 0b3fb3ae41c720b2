"""What is computed at the end of a run: a failure there leaves the rest of the run whole."""

import errno
import json
import logging
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.core import keep_going
from slam_bof.errors import RunError
from slam_bof.geometry import read_kitti, read_tum, se3
from slam_bof.run import RunInterrupted, RunOptions, outputs, resume_sequence, run_sequence
from slam_bof.run.folder import link_map, make_folder
from slam_bof.scenes import LevelledClassifier
from slam_bof.slam import preset
from slam_bof.slam.config import override
from slam_bof.store import MapStore
from slam_bof.types import DepthFrame, Scene, Trajectory
from slam_bof_plugins.backend_gtsam import GtsamBackend


class BoxRoom:
    """A camera that turns in a box room, 20 frames."""

    name = "box"
    sequence = "box/turn"
    intrinsics = CAMERA

    def __len__(self) -> int:
        return 20

    def frame(self, index: int) -> DepthFrame:
        T = se3.exp(np.array([0.0, 0.02 * index, 0.0, 0.0, 0.0, 0.0]))
        return DepthFrame(index / 30, box_room_depth_mm(CAMERA, T), CAMERA)

    def color(self, index: int) -> None: ...

    def gray(self, index: int) -> None: ...

    def groundtruth(self) -> None: ...

    def scenes(self) -> None: ...


def run(out: Path, **options: bool) -> Path:
    config = override(preset("indoor"), ["keyframes.max_gap=3"])
    return run_sequence(BoxRoom(), config, out, RunOptions(**options)).folder


def test_depth_in_another_unit_is_the_reason_for_lost_frames(monkeypatch, tmp_path):
    frame = BoxRoom.frame

    def in_tenths_of_a_millimetre(self, index):
        found = frame(self, index)
        return replace(found, depth=found.depth.astype(np.float32) / 100)

    monkeypatch.setattr(BoxRoom, "frame", in_tenths_of_a_millimetre)
    folder = run(tmp_path)
    log = (folder / "run.log").read_text()
    assert "divided by 10 (units of 0.1 mm, as of RealSense D405)" in log
    assert "20 of 20 frames are lost: probably for the reason that the warning at the start" in log
    assert "too little depth" not in log
    page = (folder / "report.html").read_text()
    assert "(units of 0.1 mm, as of RealSense D405)" in page[page.index("<h2>Warnings</h2>") :]
    assert "odometry lost</li>" not in page


def test_labels_that_are_no_numbers_are_no_labels(monkeypatch, tmp_path):
    label = LevelledClassifier.label

    def fail_at_times(self, frame, **options):
        scene = label(self, frame, **options)
        if round(frame.stamp_s * 30) % 2:
            nothing = np.full(len(scene.classes), np.nan)
            return Scene(scene.classes[0], np.nan, scene.classes, nothing)
        return scene

    monkeypatch.setattr(LevelledClassifier, "label", fail_at_times)
    with MapStore.open(run(tmp_path) / "map.db") as store:
        assert store.sessions()[0].is_finished
        scenes = [k.scene for k in store.keyframes()]
    known = [scene is not None for scene in scenes]
    assert any(known)
    assert not all(known)
    assert all(np.isfinite(scene.probabilities).all() for scene in scenes if scene)


def test_a_failure_at_the_end_leaves_everything_else(monkeypatch, tmp_path):
    def fail(*args, **options):
        raise IndexError("no such room")

    monkeypatch.setattr("slam_bof.maps.map_session.label_map", fail)
    monkeypatch.setattr("slam_bof.run.outputs.write_report", fail)
    monkeypatch.setattr("slam_bof.run.outputs.write_sequence_cloud", fail)
    monkeypatch.setattr(GtsamBackend, "write_g2o", fail)
    folder = run(tmp_path)
    with MapStore.open(folder / "map.db") as store:
        assert store.sessions()[0].is_finished
        assert all(keyframe.smoothed for keyframe in store.keyframes())
    assert json.loads((folder / "metrics.json").read_text())["n_regions"] == 0
    assert (folder / "loops.csv").exists()
    assert len(read_tum(folder / "trajectory_optimized_tum.txt")) == 20
    log = (folder / "run.log").read_text()
    for result in ("rooms and smoothed labels", "pose_graph.g2o", "map.ply", "report.html"):
        assert f"{result} could not be computed and is left out" in log


def test_a_full_disk_is_an_error_still():
    with pytest.raises(OSError, match="full"), keep_going("map.ply", RunError):
        raise OSError("full")


def test_a_true_pose_that_is_unknown_is_in_no_file_for_other_tools(monkeypatch, tmp_path):
    poses = np.tile(np.eye(4), (20, 1, 1))
    monkeypatch.setattr(BoxRoom, "groundtruth", lambda self: Trajectory(np.arange(20) / 30, poses))
    whole = run(tmp_path / "whole")
    assert len(read_kitti(whole / "trajectory_groundtruth_kitti.txt")) == 20
    poses[7] = np.nan
    folder = run(tmp_path / "gap")
    assert not (folder / "trajectory_groundtruth_kitti.txt").exists()
    assert len(read_tum(folder / "trajectory_groundtruth_tum.txt")) == 19
    assert "trajectory_groundtruth_kitti.txt: not written, 1 poses" in (
        (folder / "run.log").read_text()
    )
    for path in folder.glob("trajectory_*.txt"):
        assert "nan" not in path.read_text()


@pytest.fixture
def no_symlinks(monkeypatch):
    def refuse(*args, **options):
        raise PermissionError(errno.EPERM, "Operation not permitted")

    monkeypatch.setattr(os, "symlink", refuse)


def test_a_file_system_without_links_is_without_latest(no_symlinks, tmp_path, caplog):
    folder = make_folder(tmp_path / "runs")
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [folder.name]
    link_map(folder, tmp_path / "home.db")
    assert list(folder.iterdir()) == []
    assert "latest: cannot be linked to" in caplog.text
    assert "map.db: cannot be linked to" in caplog.text


def test_a_folder_named_latest_stays(tmp_path, caplog):
    (tmp_path / "latest").mkdir()
    (tmp_path / "latest" / "mine.txt").touch()
    folder = make_folder(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"latest", folder.name}
    assert (tmp_path / "latest" / "mine.txt").exists()
    assert "latest: cannot be linked to" in caplog.text


def test_a_run_keeps_no_colour_unless_asked(monkeypatch, tmp_path):
    rgb = np.full((CAMERA.height, CAMERA.width, 3), 200, np.uint8)
    monkeypatch.setattr(BoxRoom, "color", lambda self, index: rgb)
    assert b"property uchar red" not in (run(tmp_path / "a") / "map.ply").read_bytes()
    colored = run(tmp_path / "b", with_color=True)
    assert b"property uchar red" in (colored / "map.ply").read_bytes()


def test_the_log_has_warnings_of_plugins_and_how_the_run_ended(monkeypatch, tmp_path):
    frame = BoxRoom.frame

    def warn_and_fail(self, index):
        if index == 5:
            logging.getLogger("slam_bof_plugins.dataset_box").warning("a strange frame")
            logging.getLogger("slam_bof_plugins.dataset_box").info("taking /camera_info")
            logging.getLogger("stranger").info("nothing of interest")
            logging.getLogger("stranger").warning("a strange plug-in")
        if index == 9:
            raise RuntimeError("the cable is out")
        return frame(self, index)

    monkeypatch.setattr(BoxRoom, "frame", warn_and_fail)
    monkeypatch.setattr("slam_bof.run.job.find_doubts", lambda dataset, sensor: [])
    with pytest.raises(RuntimeError):
        run(tmp_path)
    (log,) = tmp_path.glob("2*/run.log")
    lines = log.read_text().splitlines()
    assert any("WARNING slam_bof_plugins.dataset_box: a strange frame" in line for line in lines)
    assert any("INFO slam_bof_plugins.dataset_box: taking /camera_info" in line for line in lines)
    assert any("WARNING stranger: a strange plug-in" in line for line in lines)
    assert not any("nothing of interest" in line for line in lines)
    assert lines[-1].endswith("failed: RuntimeError: the cable is out")


@pytest.mark.parametrize("stage", ["write_health", "write_report"])
def test_ctrl_c_while_files_are_written_says_how_to_go_on(monkeypatch, tmp_path, stage):
    def interrupt(*arguments, **options):
        raise KeyboardInterrupt

    whole = run(tmp_path / "whole")
    with monkeypatch.context() as patch:
        patch.setattr(outputs, stage, interrupt)
        with pytest.raises(RunInterrupted) as caught:
            run(tmp_path / "cut")
    cut = caught.value.folder
    assert caught.value.n_frames == 20
    assert "interrupted after 20 frames" in (cut / "run.log").read_text()
    assert resume_sequence(BoxRoom(), cut / "map.db", tmp_path).folder == cut
    assert {file.name for file in whole.iterdir()} == {file.name for file in cut.iterdir()}
    for name in (
        "trajectory_optimized_tum.txt",
        "pose_graph.g2o",
        "loops.csv",
        "map.ply",
        "health.csv",
    ):
        assert (whole / name).read_bytes() == (cut / name).read_bytes()
