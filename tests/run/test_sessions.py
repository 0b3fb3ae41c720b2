"""One map of several sessions: joined while running, merged afterwards, pruned, gone on with."""

import json
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof import LoopCloser
from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.errors import DatasetError, MapError, RunError
from slam_bof.evaluation.trajectory_metrics import ate
from slam_bof.geometry import se3
from slam_bof.maps import MapLocalizer, merge_maps
from slam_bof.run import RunOptions, read_run, run_sequence
from slam_bof.scenes import model as models
from slam_bof.slam import preset
from slam_bof.slam.config import override
from slam_bof.store import (
    MapStore,
    check_map,
    components_of,
    find_redundant_keyframes,
    prune_map,
    replay_keyframes,
)
from slam_bof.synthetic import Scene3D, make_room, spin, write_sequence
from slam_bof.types import Trajectory

QUICK = override(preset("indoor"), ["loops.min_age_s=1.0", "keyframes.max_gap=5"])
SHORT = RunOptions(max_frames=10)


@pytest.fixture(scope="module")
def sequences(tmp_path_factory):
    """Two turns of 70 degrees in one room, the second the other way round and a step aside."""
    folder = tmp_path_factory.mktemp("sessions") / "room"
    scene = Scene3D(make_room("living_room", seed=3).mesh)
    there = spin(2.5, 2.3, rate_deg_s=60.0, angle_deg=70.0, pitch=0.3)[5:45]
    back = spin(2.45, 2.35, rate_deg_s=60.0, angle_deg=70.0, pitch=0.3)[5:45][::-1]
    for name, poses in (("seq-01", there), ("seq-02", back)):
        write_sequence(folder / name, scene, poses)
    return [registry.open_dataset(folder / name, "auto") for name in ("seq-01", "seq-02")]


@pytest.fixture(scope="module")
def joined(sequences, tmp_path_factory):
    """The map of both, and the folders of their runs."""
    out = tmp_path_factory.mktemp("joined")
    map_file = out / "home.db"
    return map_file, [run_sequence(s, QUICK, out, map_file=map_file) for s in sequences]


@pytest.fixture(scope="module")
def apart(sequences, tmp_path_factory):
    """The maps of either by itself."""
    out = tmp_path_factory.mktemp("apart")
    return [run_sequence(s, QUICK, out).folder / "map.db" for s in sequences]


def error_m(map_file, sequences) -> float:
    """Return the ATE (RMSE) of all keyframes of a map, in one frame."""
    with MapStore.open(map_file) as store:
        keyframes, found = store.keyframes(), store.map_poses()
    assert {k.session for k in keyframes} == {0, 1}
    truth = np.array([sequences[k.session].groundtruth().poses[k.frame_index] for k in keyframes])
    stamps_s = np.arange(len(truth), dtype=float)
    result = ate(Trajectory(stamps_s, found), Trajectory(stamps_s, truth))
    assert result is not None
    return result.rmse_m


def test_a_second_session_joins_the_map_of_the_first(joined, sequences):
    map_file, (first, second) = joined
    assert (first.metrics["n_loops_across"], first.metrics["session"]) == (0, 0)
    assert second.metrics["session"] == 1
    assert second.metrics["n_loops_across"] > 4
    assert second.metrics["n_components"] == 1
    assert error_m(map_file, sequences) < 0.03
    assert check_map(map_file) == []
    with MapStore.open(map_file) as store:
        assert [(s.sequence, s.is_finished) for s in store.sessions()] == [
            ("room/seq-01", True),
            ("room/seq-02", True),
        ]
        assert [len(store.frames(k)) for k in (0, 1)] == [40, 40]


def test_a_run_s_folder_is_of_its_own_session(joined):
    map_file, runs = joined
    for run in runs:
        assert (run.folder / "map.db").resolve() == map_file.resolve()
        found = read_run(run.folder)
        assert len(found.keyframes) == run.metrics["n_keyframes"]
        assert [k.id for k in found.keyframes] == list(range(len(found.keyframes)))
        assert max(k.frame_index for k in found.keyframes) < 40
        assert len(found.loops) == run.metrics["n_loops"] + run.metrics["n_covisibility_edges"]
        assert len(found.optimized) == 40
        assert json.loads((run.folder / "metrics.json").read_text()) == run.metrics


UNKNOWN = "".join(f"{k / 30} {'nan' if k == 7 else k} 0 0 0 0 0 1\n" for k in range(40))


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("metrics.json", "[" * 100_000, "expected the metrics of a run"),
        ("metrics.json", "[]", "expected the metrics of a run"),
        ("metrics.json", '{"loop_precision": [1]}', "a list or object as 'loop_precision'"),
        ("health.csv", "health,n_open\ntracked,1e38\n", "expected columns health, n_open"),
        ("health.csv", "health\ntracked\n", "expected columns health, n_open"),
        ("health.csv", "health,n_open\n" + "x" * 200_000, "expected columns health, n_open"),
        ("config.yaml", b"\xff\xfe\x00", "expected text"),
        ("trajectory_odometry_tum.txt", "0 0 0 0 0 0 0 1\n", "expected the same frames"),
        ("trajectory_odometry_tum.txt", UNKNOWN, "found unknown poses in its trajectories"),
    ],
)
def test_a_run_s_folder_with_a_damaged_file_is_refused(apart, tmp_path, name, text, message):
    folder = tmp_path / "run"
    shutil.copytree(apart[0].parent, folder)
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(RunError, match=message) as caught:
        read_run(folder)
    assert len(str(caught.value)) < 500


def test_maps_are_merged_by_what_is_recognised(apart, sequences, tmp_path):
    out = tmp_path / "merged.db"
    merged = merge_maps(apart, out)
    assert (merged.n_sessions, merged.n_components) == (2, 1)
    assert merged.n_loops_across > 4
    assert error_m(out, sequences) < 0.03
    assert check_map(out) == []
    with pytest.raises(MapError, match="found a file, expected none"):
        merge_maps(apart, out)


def test_a_merge_that_fails_leaves_nothing(apart, tmp_path):
    other = tmp_path / "other.db"
    shutil.copy(apart[1], other)
    with MapStore.open(other, read_only=False) as store:
        store.set_parameters({"model": "another"})
    with pytest.raises(MapError, match="found model another, expected that of"):
        merge_maps([apart[0], other], tmp_path / "merged.db")
    assert [path.name for path in tmp_path.iterdir()] == ["other.db"]


def test_a_pruned_map_stays_where_it_is_and_can_be_joined(joined, sequences, tmp_path):
    map_file = tmp_path / "pruned.db"
    shutil.copy(joined[0], map_file)
    with MapStore.open(map_file) as store:
        before = {(k.session, k.frame_index): T for k, T in zip(
            store.keyframes(), store.map_poses(), strict=True
        )}  # fmt: skip
        dropped = find_redundant_keyframes(store, distance_m=0.2, angle_rad=0.3)
        assert 0 < len(dropped) < len(before)
    size = map_file.stat().st_size
    n = prune_map(
        map_file, lambda store: find_redundant_keyframes(store, distance_m=0.2, angle_rad=0.3)
    )
    assert n == len(dropped)
    assert map_file.stat().st_size < size
    assert check_map(map_file) == []
    with MapStore.open(map_file) as store:
        keyframes, poses = store.keyframes(), store.map_poses()
        assert [k.id for k in keyframes] == list(range(len(before) - n))
        assert len(set(components_of(store))) == 1
        for keyframe, T in zip(keyframes, poses, strict=True):
            np.testing.assert_array_equal(T, before[keyframe.session, keyframe.frame_index])
        closer = LoopCloser.from_config(QUICK)
        closer.restore(replay_keyframes(store))
    errors = se3.inverse(closer.map.poses()) @ poses
    assert np.linalg.norm(errors[:, :3, 3], axis=1).max() < 0.01
    again = run_sequence(sequences[0], QUICK, tmp_path, map_file=map_file)
    assert (again.metrics["n_components"], again.metrics["session"]) == (1, 2)
    assert again.metrics["ate_m"] < 0.03


def test_a_session_can_be_dropped(joined, tmp_path):
    map_file = tmp_path / "first.db"
    shutil.copy(joined[0], map_file)
    prune_map(map_file, lambda store: [k.id for k in store.keyframes() if k.session == 1])
    with MapStore.open(map_file) as store:
        assert {k.session for k in store.keyframes()} == {0}
        assert store.frames(1) == []
    assert check_map(map_file) == []


def test_the_map_says_where_a_frame_was_taken(joined, sequences):
    map_file, runs = joined
    places = MapLocalizer.open(map_file)
    frame = sequences[0].frame(21)
    located = places.localize(frame)
    assert located.localization.is_known, located.localization.reason
    truth = read_run(runs[0].folder).optimized.poses[21]
    off = se3.inverse(truth) @ located.localization.T_map_camera
    assert np.linalg.norm(off[:3, 3]) < 0.05
    assert located.keyframe is not None
    assert located.room == (located.keyframe.smoothed or located.keyframe.scene).label
    blank = replace(frame, depth=np.zeros_like(frame.depth))
    assert not places.localize(blank).localization.is_known
    other = replace(frame, intrinsics=replace(frame.intrinsics, fx=500.0))
    with pytest.raises(DatasetError, match="expected the map's camera"):
        places.localize(other)


def test_localize_by_the_command_line(joined, sequences, tmp_path):
    map_file, _ = joined
    folder = tmp_path / "room" / "seq-01"
    write = [str(map_file), str(folder)]
    folder.mkdir(parents=True)
    for index in (0, 20):
        cv2.imwrite(
            str(folder / f"frame-{index // 20:06d}.depth.png"), sequences[0].frame(index).depth
        )
    table = CliRunner().invoke(app, ["localize", *write])
    assert table.exit_code == 0, table.output
    assert "of 2 frames localized" in table.stdout
    rows = json.loads(CliRunner().invoke(app, ["localize", *write, "--json"]).stdout)
    assert [row["frame_index"] for row in rows] == [0, 1]
    assert all(row["is_known"] == (row["T_map_camera"] is not None) for row in rows)
    assert all(row["component"] == (0 if row["is_known"] else None) for row in rows)
    refused = CliRunner().invoke(app, ["localize", *write, "--component", "3"])
    assert (refused.exit_code, refused.stdout) == (1, "")
    assert "found no component 3, expected one of: 0" in refused.stderr
    image = str(folder / "frame-000001.depth.png")
    one = json.loads(CliRunner().invoke(app, ["localize", str(map_file), image, "--json"]).stdout)
    assert one["T_map_camera"] == rows[1]["T_map_camera"]
    missing = CliRunner().invoke(app, ["localize", str(tmp_path / "none.db"), image])
    assert (missing.exit_code, missing.stdout) == (1, "")
    assert "none.db: found no file, expected a map.db" in missing.stderr


def test_a_map_of_an_earlier_default_model_keeps_its_model(sequences, tmp_path, monkeypatch):
    first, second = sequences
    map_file = tmp_path / "old.db"
    earlier = models.resolve("synthetic")
    with monkeypatch.context() as patch:
        # A version whose default was today's synthetic model.
        patch.setattr(models, "resolve", lambda name: earlier)
        run_sequence(first, QUICK, tmp_path, SHORT, map_file=map_file)
    with MapStore.open(map_file) as store:
        assert "model: default" in store.sessions()[0].config
    assert earlier.content_hash != models.resolve("default").content_hash
    classes = set(earlier.levelled_classifier.network.classes_)
    found = MapLocalizer.open(map_file).localize(second.frame(0))
    assert set(found.scene.classes) == classes
    run_sequence(second, QUICK, tmp_path, SHORT, map_file=map_file)
    with MapStore.open(map_file) as store:
        assert store.parameters()["model"] == earlier.content_hash
        assert len(store.sessions()) == 2
        assert {name for k in store.keyframes() for name in k.scene.classes} == classes


def test_a_map_of_a_default_model_of_the_past_is_continued(sequences, apart, tmp_path, caplog):
    _, second = sequences
    map_file = tmp_path / "old.db"
    shutil.copy(apart[0], map_file)
    with MapStore.open(map_file, read_only=False) as store:
        store.set_parameters({"model": next(iter(models.SUPERSEDED))})
    run_sequence(second, QUICK, tmp_path, SHORT, map_file=map_file)
    with MapStore.open(map_file) as store:
        assert len(store.sessions()) == 2
    assert "made with an earlier default model, 9e04125ebb8c; its labels are" in caplog.text
    with pytest.raises(MapError, match="all sessions of a map use one model"):
        run_sequence(second, override(QUICK, ["model=synthetic"]), tmp_path, map_file=map_file)
