"""The whole chain, end to end, on a short real-looking sequence: there and back in one room."""

import csv
import json
import shutil
import sqlite3
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from slam_bof import DepthFrame, LoopCloser
from slam_bof.core import registry
from slam_bof.errors import FrameError
from slam_bof.geometry import read_kitti, read_tum
from slam_bof.run import read_run, run_sequence
from slam_bof.slam import preset
from slam_bof.slam.config import load, override
from slam_bof.store import MapStore, components_of
from slam_bof.synthetic import KINECT, Scene3D, make_room, spin, write_sequence
from slam_bof_plugins.odometry_kiss_icp import KissIcpOdometry

FILES = {
    "config.yaml", "loops.csv", "map.db", "map.ply", "metrics.json", "pose_graph.g2o",
    "report.html", "run.log", "health.csv",
    *(f"trajectory_{name}_{form}.txt"
      for name in ("odometry", "optimized", "groundtruth") for form in ("tum", "kitti")),
}  # fmt: skip
QUICK_LOOPS = ["loops.min_age_s=1.0", "loops.normaliser_lag_s=0.3", "keyframes.max_gap=5"]


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """A camera that turns by 60 degrees and back, 90 frames, in 7-Scenes layout."""
    there = spin(2.5, 2.3, rate_deg_s=60.0, angle_deg=60.0, pitch=0.3)[5:50]
    folder = tmp_path_factory.mktemp("there_and_back") / "room" / "seq-01"
    scene = Scene3D(make_room("living_room", seed=3).mesh)
    write_sequence(folder, scene, np.concatenate([there, there[::-1]]))
    return folder


def run(sequence, out, *assignments):
    config = override(preset("indoor"), [*QUICK_LOOPS, *assignments])
    return run_sequence(registry.open_dataset(sequence, "auto"), config, out)


@pytest.fixture(scope="module")
def finished(sequence, tmp_path_factory):
    return run(sequence, tmp_path_factory.mktemp("runs"))


def test_a_run_leaves_everything(finished):
    assert {path.name for path in finished.folder.iterdir()} == FILES
    assert (finished.folder.parent / "latest").resolve() == finished.folder.resolve()
    assert json.loads((finished.folder / "metrics.json").read_text()) == finished.metrics


def test_true_poses_of_another_clock_are_moved_before_errors_are_measured(
    sequence, finished, tmp_path
):
    """Three frames late, at 60 degrees a second."""
    assert finished.metrics["groundtruth_offset_s"] == 0.0
    late = run(sequence, tmp_path, "groundtruth_offset_s=0.1")
    assert late.metrics["groundtruth_offset_s"] == 0.1
    assert late.metrics["covisibility_precision"] < 0.8 < finished.metrics["covisibility_precision"]
    moved = read_tum(late.folder / "trajectory_groundtruth_tum.txt")
    truth = read_tum(finished.folder / "trajectory_groundtruth_tum.txt")
    assert len(moved) == len(truth) - 3
    np.testing.assert_allclose(moved.poses, truth.poses[:-3], atol=1e-6)
    assert "time added to the stamps of true poses" in (late.folder / "report.html").read_text()


def test_it_finds_true_loops_and_they_help(finished):
    metrics = finished.metrics
    assert metrics["n_frames"] == 90
    assert metrics["n_loops"] > 0
    assert metrics["loop_precision"] == 1.0
    assert metrics["ate_m"] < metrics["ate_odometry_m"]
    assert 0.8 * metrics["ate_m"] < metrics["ate_live_m"] < metrics["ate_odometry_m"]
    assert 0.0 < metrics["keyframe_nees"] < 5.0
    assert 0.2 < metrics["edge_nees"] < 5.0
    assert metrics["scene_accuracy"] is None


def test_the_report_shows_loops_as_depth_images(finished):
    folder = finished.folder
    pairs = read_run(folder).pairs
    assert {pair.candidate.decision for pair in pairs} >= {"accepted"}
    html = (folder / "report.html").read_text(encoding="utf-8")
    assert html.count("data:image/jpeg;base64,") == len(pairs)
    assert (folder / "report.html").stat().st_size < 8e6


def test_keyframes_are_counted_by_how_far_their_search_came(finished):
    metrics = finished.metrics
    names = ("candidate", "between", "discarded", "unjudged")
    counts = {name: metrics[f"n_keyframes_{name}"] for name in names}
    assert 0 < sum(counts.values()) < metrics["n_keyframes"]  # the first have none to search
    assert 0 < metrics["n_keyframes_approved"] <= counts["candidate"]
    assert counts["between"] == counts["unjudged"] == 0  # views have one threshold, no normaliser


def test_stages_are_parts_of_the_whole(finished):
    stages = {k: v for k, v in finished.metrics.items() if k.startswith("stage_ms.")}
    total = stages.pop("stage_ms.total")
    assert all(value > 0 for value in stages.values())
    assert sum(stages.values()) <= total


def test_trajectories_have_every_frame_at_full_precision(finished):
    for name in ("odometry", "optimized", "groundtruth"):
        tum = read_tum(finished.folder / f"trajectory_{name}_tum.txt")
        kitti = read_kitti(finished.folder / f"trajectory_{name}_kitti.txt")
        np.testing.assert_allclose(tum.stamps_s, np.arange(90) / 30.0)
        np.testing.assert_allclose(tum.poses, kitti.poses, atol=1e-12)


def test_the_audit_trail_names_each_decision(finished):
    with (finished.folder / "loops.csv").open() as file:
        rows = list(csv.DictReader(file))
    accepted = [r for r in rows if r["decision"] == "accepted"]
    graph = sqlite3.connect(finished.folder / "map.db")
    assert len(accepted) == graph.execute("SELECT count(*) FROM loops").fetchone()[0]
    assert all(r["reason"] for r in rows if r["decision"] != "accepted")
    graph.close()
    with MapStore.open(finished.folder) as store:
        components = components_of(store)
    assert [int(r["component"]) for r in rows] == [components[int(r["query_id"])] for r in rows]
    with (finished.folder / "health.csv").open() as file:
        frames = list(csv.DictReader(file))
    assert len(frames) == 90
    for frame in frames:
        assert (frame["component"] == "") == (frame["health"] == "lost")
        assert float(frame["sigma_m"]) > 0.0
        assert (float(frame["sigma_rad"]) < 0.1) == (frame["health"] == "tracked")
    assert {int(frame["component"]) for frame in frames if frame["component"]} == set(
        components.tolist()
    )


def test_the_map_has_raw_and_smoothed_labels_and_rooms(finished):
    with MapStore.open(finished.folder / "map.db") as store:
        keyframes, rooms = store.keyframes(), store.rooms()
    assert all(k.scene is not None and k.smoothed is not None for k in keyframes)
    own, smoothed = (
        np.array([scene.probabilities for scene in scenes])
        for scenes in ([k.scene for k in keyframes], [k.smoothed for k in keyframes])
    )
    assert np.abs(np.diff(smoothed, axis=0)).sum() < np.abs(np.diff(own, axis=0)).sum()
    assert len(rooms) == finished.metrics["n_regions"] >= 1
    inside = [id_ for room in rooms for id_ in room.keyframe_ids]
    assert sorted(inside) == [k.id for k in keyframes]


def test_a_run_s_configuration_repeats_it_to_the_byte(finished, sequence, tmp_path):
    config = load(finished.folder / "config.yaml")
    again = run_sequence(registry.open_dataset(sequence, "auto"), config, tmp_path)
    for name in FILES - {"metrics.json", "report.html", "run.log", "health.csv", "map.db"}:
        assert (again.folder / name).read_bytes() == (finished.folder / name).read_bytes(), name


def test_damaged_and_blind_frames_do_not_stop_a_run(sequence, tmp_path):
    damaged = tmp_path / "room" / "seq-01"
    shutil.copytree(sequence, damaged)
    frames = sorted(damaged.glob("*.depth.png"))
    frames[20].write_bytes(frames[20].read_bytes()[:5000])
    blind = np.zeros((480, 640), np.uint16)
    for frame in frames[60:64]:
        cv2.imwrite(str(frame), blind)
    for pose in damaged.glob("*.pose.txt"):
        pose.unlink()
    result = run(damaged, tmp_path / "runs")
    assert result.metrics["n_frames"] == 89
    assert result.metrics["n_frames_skipped"] == 1
    assert result.metrics["ate_m"] is None
    assert "frame 20 skipped" in (result.folder / "run.log").read_text()
    assert len(read_tum(result.folder / "trajectory_optimized_tum.txt")) == 89


def blinded(sequence, folder, n):
    """Copy the first 12 frames, of which the first n show nothing."""
    folder.mkdir(parents=True)
    for i, file in enumerate(sorted(sequence.glob("*.depth.png"))[:12]):
        depth = np.zeros((480, 640), np.uint16) if i < n else cv2.imread(str(file), -1)
        cv2.imwrite(str(folder / file.name), depth)
        pose = file.name.replace("depth.png", "pose.txt")
        shutil.copy(sequence / pose, folder / pose)
    return folder


def test_a_sequence_that_shows_nothing_leaves_everything_too(sequence, tmp_path):
    result = run(blinded(sequence, tmp_path / "room" / "seq-01", 12), tmp_path / "runs")
    assert {path.name for path in result.folder.iterdir()} == FILES
    assert result.metrics["n_frames"] == result.metrics["n_frames_lost"] == 12
    assert result.metrics["n_keyframes"] == result.metrics["n_components"] == 0
    assert len(read_tum(result.folder / "trajectory_optimized_tum.txt")) == 12
    assert b"element vertex 0\n" in (result.folder / "map.ply").read_bytes()
    assert "12 of 12 frames are lost" in (result.folder / "run.log").read_text()


def test_a_sequence_may_begin_blind(sequence, tmp_path):
    result = run(blinded(sequence, tmp_path / "room" / "seq-01", 10), tmp_path / "runs")
    assert result.metrics["n_frames_lost"] == 10
    assert result.metrics["n_odometry_lost"] == 0
    assert result.metrics["n_keyframes"] == 1
    assert len(read_tum(result.folder / "trajectory_optimized_tum.txt")) == 12


def test_the_readme_s_two_calls(sequence):
    """The README's example, to the letter, beside an odometry of one's own."""
    readme = (Path(__file__).parents[2] / "README.md").read_text(encoding="utf-8")
    example = readme.split("```python\n")[1].split("```")[0]
    dataset, odometry = registry.open_dataset(sequence, "auto"), KissIcpOdometry()

    def my_odometry():
        for frame in map(dataset.frame, range(30)):
            yield frame.stamp_s, frame.depth, odometry.process(frame)

    names = {"my_odometry": my_odometry()}
    exec(compile(example, "README.md", "exec"), names)
    assert names["step"].scene.label in names["step"].scene.classes
    assert len(names["trajectory"]) == 30
    np.testing.assert_allclose(names["trajectory"].poses[-1], names["T_map_camera"], atol=0.05)


def test_stamps_must_grow():
    frame = DepthFrame(1.0, np.zeros((480, 640), np.uint16), KINECT)
    closer = LoopCloser.from_preset("indoor")
    closer.process(frame, np.eye(4))
    for stamp_s in (1.0, 0.5, np.nan):
        with pytest.raises(ValueError, match="time stamps must increase"):
            closer.process(replace(frame, stamp_s=stamp_s), np.eye(4))


def test_a_stamp_from_the_future_is_not_the_clock():
    frame = DepthFrame(1.7e9, np.zeros((480, 640), np.uint16), KINECT)
    closer = LoopCloser.from_preset("indoor")
    closer.process(frame, np.eye(4))
    with pytest.raises(FrameError, match=r"must be in seconds, got 17315\d+.0 s more than a day"):
        closer.process(replace(frame, stamp_s=1.7e9 + 3.15e7), np.eye(4))
    closer.process(replace(frame, stamp_s=1.7e9 + 0.1), np.eye(4))
    # A clock that has really moved is followed, at the cost of one frame.
    with pytest.raises(FrameError):
        closer.process(replace(frame, stamp_s=1.8e9), np.eye(4))
    closer.process(replace(frame, stamp_s=1.8e9 + 0.1), np.eye(4))
    assert closer.finish().stamps_s.tolist() == [1.7e9, 1.7e9 + 0.1, 1.8e9 + 0.1]


def test_a_camera_whose_focus_moves_is_one_camera(box_room_frame):
    closer = LoopCloser.from_preset("indoor")
    camera = box_room_frame.intrinsics
    for k, change in enumerate((0.0, 1e-15, 0.001, -0.004)):
        focal = camera.fx * (1 + change)
        moved = replace(camera, fx=focal, fy=focal, cx=camera.cx + 100 * change)
        closer.process(replace(box_room_frame, stamp_s=float(k), intrinsics=moved), np.eye(4))
    zoomed = replace(box_room_frame, stamp_s=9.0, intrinsics=replace(camera, fx=camera.fx * 1.006))
    with pytest.raises(FrameError, match="frames must all be of"):
        closer.process(zoomed, np.eye(4))
    assert len(closer.finish()) == 4


def test_frames_are_of_one_camera(box_room_frame):
    closer = LoopCloser.from_preset("indoor")
    closer.process(box_room_frame, np.eye(4))
    zoomed = replace(box_room_frame.intrinsics, fx=box_room_frame.intrinsics.fx * 2)
    other = replace(box_room_frame, stamp_s=1e3, intrinsics=zoomed)
    with pytest.raises(ValueError, match=r"frames must all be of Intrinsics.*, got one of Intrin"):
        closer.process(other, np.eye(4))
    assert len(closer.finish()) == 1


BAD_POSES = {
    "NaN": np.full((4, 4), np.nan),
    "rotation .determinant 8": np.diag([2.0, 2.0, 2.0, 1.0]),
    "rotation .determinant -1": np.diag([-1.0, 1.0, 1.0, 1.0]),
    r"\(4,\)": np.ones(4),
    r"\(3, 4\) matrix, expected \(4, 4\): its last row is 0 0 0 1": np.eye(4)[:3],
}


@pytest.mark.parametrize("name", ["indoor", "paper"])
@pytest.mark.parametrize("found", BAD_POSES)
def test_what_is_no_pose_is_named_and_does_no_harm(found, name, box_room_frame):
    frames = [replace(box_room_frame, stamp_s=float(i)) for i in range(3)]
    closer = LoopCloser.from_preset(name)
    closer.process(frames[0], np.eye(4))
    with pytest.raises(ValueError, match=rf"^T_odom_camera of frame 1, at 1.0 s: found .*{found}"):
        closer.process(frames[1], BAD_POSES[found])
    closer.process(frames[2], np.eye(4))
    np.testing.assert_allclose(closer.finish().poses, [np.eye(4)] * 2, atol=1e-6)


def test_nothing_in_nothing_out():
    assert len(LoopCloser.from_preset("indoor").finish()) == 0


def test_the_saved_configuration_holds_every_option_of_every_plugin(finished):
    saved = (finished.folder / "config.yaml").read_text()
    assert "max_points_per_voxel:" in saved
    assert "cauchy:" in saved
    assert "max_free_space_violation:" in saved


def test_where_odometry_was_lost_is_told(tmp_path):
    poses = spin(2.5, 2.3, rate_deg_s=60.0, angle_deg=60.0, pitch=0.3)[5:35]
    scene = Scene3D(make_room("living_room", seed=3).mesh)
    write_sequence(tmp_path / "room" / "seq-01", scene, poses, dark=range(12, 16))
    finished = run(tmp_path / "room" / "seq-01", tmp_path / "runs")
    assert finished.metrics["n_odometry_lost"] == 1
    log = (finished.folder / "run.log").read_text()
    assert "frame 12: odometry lost" in log
    assert "frame 16: odometry recovered" in log
    with sqlite3.connect(finished.folder / "map.db") as db:
        frames = [row[0] for row in db.execute("SELECT frame_index FROM keyframes")]
    assert not set(frames) & set(range(12, 16))
