import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from slam_bof import se3
from slam_bof.errors import MapError
from slam_bof.regions import Region
from slam_bof.schema import SCHEMA_VERSION, SMOOTHED
from slam_bof.store import MapStore
from slam_bof.types import Bag, Candidate, Keyframe, Loop, Scene

CLASSES = ("kitchen", "office")


def make_keyframe(id_: int, *, scene: bool = True) -> Keyframe:
    rng = np.random.default_rng(id_)
    words = np.sort(rng.choice(1024, 200, replace=False)).astype(np.int32)
    weights = rng.random(200).astype(np.float32)
    p = float(rng.uniform(0.5, 1.0))
    label = Scene(CLASSES[id_ % 2], p, CLASSES, np.roll([p, 1 - p], id_ % 2))
    bag = Bag(words, weights / weights.sum())
    T = se3.exp(rng.normal(size=6))
    return Keyframe(id_, 4 * id_, 4 * id_ / 30.0, T, bag, label if scene else None, id_ // 3)


def make_loop(query_id: int, match_id: int, kind: str = "loop") -> Loop:
    rng = np.random.default_rng(query_id)
    A = rng.normal(size=(6, 6))
    return Loop(query_id, match_id, se3.exp(rng.normal(size=6)), A @ A.T, kind, "bag")


def make_candidate(query_id: int, match_id: int) -> Candidate:
    return Candidate(
        query_id, match_id, "bag", score=0.25, normaliser=0.5, eta=0.5, n_consistent=2,
        overlap=0.7, rmse_m=0.012, decision="accepted", reason="overlap 0.70",
    )  # fmt: skip


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.db"


@pytest.fixture
def filled(path: Path) -> Iterator[MapStore]:
    """A map of 6 keyframes with a loop and a covisibility edge."""
    with MapStore.create(path) as store:
        for id_ in range(5):
            store.add(make_keyframe(id_))
        rejected = Candidate(5, 3, "proximity", decision="rejected", reason="overlap 0.10")
        edges = [make_loop(5, 0), make_loop(5, 4, "covisibility")]
        store.add(make_keyframe(5), [make_candidate(5, 0), rejected], edges)
        yield store


def test_keyframes_come_back_as_they_went_in(filled: MapStore) -> None:
    for id_, found in enumerate(filled.keyframes()):
        added = make_keyframe(id_)
        assert (found.id, found.frame_index, found.stamp_s) == (id_, 4 * id_, 4 * id_ / 30.0)
        np.testing.assert_allclose(found.T_odom_camera, added.T_odom_camera, atol=2e-15)
        assert found.segment == added.segment
        np.testing.assert_array_equal(found.bag.words, added.bag.words)
        np.testing.assert_array_equal(found.bag.weights, added.bag.weights)
        assert (found.bag.words.dtype, found.bag.weights.dtype) == (np.int32, np.float32)
        assert found.scene is not None
        assert added.scene is not None
        assert (found.scene.label, found.scene.probability, found.scene.classes) == (
            added.scene.label, added.scene.probability, CLASSES,
        )  # fmt: skip
        np.testing.assert_array_equal(found.scene.probabilities, added.scene.probabilities)


def test_loops_come_back_as_they_went_in(filled: MapStore) -> None:
    found, near = filled.loops()
    added = make_loop(5, 0)
    assert (found.query_id, found.match_id, found.kind, found.source) == (5, 0, "loop", "bag")
    assert near.kind == "covisibility"
    np.testing.assert_allclose(found.T_match_query, added.T_match_query, atol=2e-15)
    np.testing.assert_array_equal(found.information, added.information)


def test_candidates_come_back_with_nan_where_nothing_was_measured(filled: MapStore) -> None:
    first, second = filled.candidates()
    for field in fields(Candidate):
        np.testing.assert_equal(
            getattr(first, field.name), getattr(make_candidate(5, 0), field.name)
        )
    assert np.isnan([second.score, second.eta, second.overlap, second.rmse_m]).all()
    assert second.reason == "overlap 0.10"


def test_numpy_numbers_are_saved_as_numbers(path: Path) -> None:
    with MapStore.create(path) as store:
        keyframe = replace(make_keyframe(0), id=np.int64(0), frame_index=np.int32(0))
        candidate = replace(make_candidate(0, 0), match_id=np.int64(0), eta=np.float32(0.5))
        store.add(keyframe, [candidate], [replace(make_loop(0, 0), match_id=np.int64(0))])
        assert store.candidates()[0].eta == 0.5
        assert store.loops()[0].match_id == 0


def test_a_keyframe_needs_no_label_and_an_empty_bag_is_one(path: Path) -> None:
    empty = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    with MapStore.create(path) as store:
        store.add(replace(make_keyframe(0, scene=False), bag=empty))
        (found,) = store.keyframes()
        assert found.scene is None
        assert found.bag.words.shape == (0,)
        assert store.classes() == ()


def test_clouds_are_kept_on_request(path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(100, 3))
    with MapStore.create(path) as store:
        store.add(make_keyframe(0), cloud=points)
        store.add(make_keyframe(1), cloud=np.empty((0, 3)))
        store.add(make_keyframe(2))
        found = store.cloud(0)
        assert found is not None
        np.testing.assert_allclose(found, points, rtol=1e-6)
        assert [None if c is None else c.shape for c in map(store.cloud, (1, 2))] == [(0, 3), None]


def test_map_poses_are_nan_until_they_are_set(filled: MapStore) -> None:
    assert np.isnan(filled.map_poses()).all()
    poses = se3.exp(np.random.default_rng(0).normal(size=(6, 6)))
    filled.set_map_poses(poses)
    np.testing.assert_allclose(filled.map_poses(), poses, atol=2e-15)
    with pytest.raises(ValueError, match=r"must be \(6, 4, 4\), got \(5, 4, 4\)"):
        filled.set_map_poses(poses[:5])


def test_parameters(filled: MapStore) -> None:
    filled.set_parameters({"seed": 3, "dataset": "7scenes", "model": None})
    filled.set_parameters({"seed": 4})
    assert filled.parameters() == {
        "seed": "4", "dataset": "7scenes", "model": "null", "classes": '["kitchen", "office"]',
    }  # fmt: skip
    assert filled.classes() == CLASSES


@pytest.mark.parametrize(
    ("candidates", "loops"),
    [([make_candidate(6, 99)], []), ([make_candidate(6, 0)], [make_loop(6, 99)])],
)
def test_a_keyframe_is_added_wholly_or_not_at_all(filled: MapStore, candidates, loops) -> None:
    with pytest.raises(ValueError, match="FOREIGN KEY"):
        filled.add(make_keyframe(6), candidates, loops)
    assert [len(x) for x in (filled.keyframes(), filled.candidates(), filled.loops())] == [6, 2, 2]
    filled.add(make_keyframe(6))
    assert len(filled.keyframes()) == 7


def test_a_keyframe_is_added_once(filled: MapStore) -> None:
    with pytest.raises(ValueError, match="UNIQUE"):
        filled.add(make_keyframe(5))


def test_scene_classes_stay_what_they_are(filled: MapStore) -> None:
    keyframe = make_keyframe(6)
    assert keyframe.scene is not None
    other = replace(keyframe.scene, classes=("bath", "hall"))
    with pytest.raises(ValueError, match="must stay"):
        filled.add(replace(keyframe, scene=other))


def test_the_views_are_readable(filled: MapStore) -> None:
    filled.set_map_poses(se3.exp(np.zeros((6, 6))))
    labels = filled.select("SELECT * FROM keyframe_labels")
    assert [row["scene"] for row in labels] == ["kitchen", "office"] * 3
    assert [row["n_loops"] for row in labels] == [0, 0, 0, 0, 0, 1]
    assert {(row["x_m"], row["y_m"], row["z_m"]) for row in labels} == {(0.0, 0.0, 0.0)}
    accepted, rejected = filled.select("SELECT * FROM loop_audit")
    assert (accepted["decision"], accepted["eta"], accepted["match_stamp_s"]) == (
        "accepted",
        0.5,
        0,
    )
    assert (rejected["source"], rejected["reason"]) == ("proximity", "overlap 0.10")


def test_a_closed_map_is_one_file_that_can_be_continued(path: Path) -> None:
    with MapStore.create(path) as store:
        store.add(make_keyframe(0))
    with MapStore.open(path, read_only=False) as store:
        store.add(make_keyframe(1), [], [make_loop(1, 0)])
        assert store.classes() == CLASSES
    assert os.listdir(path.parent) == ["map.db"]
    with MapStore.open(path) as store:
        assert [k.id for k in store.keyframes()] == [0, 1]


def test_a_map_can_be_read_while_it_is_written(filled: MapStore) -> None:
    with MapStore.open(filled.path) as reader:
        assert len(reader.keyframes()) == 6
        filled.add(make_keyframe(6))
        assert len(reader.keyframes()) == 7
        with pytest.raises(MapError, match="cannot be written: the file or its folder is read-on"):
            reader.add(make_keyframe(7))


KILLED = """
import os, signal, sys
sys.path.insert(0, sys.argv[2])
from slam_bof.store import MapStore
from test_store import make_keyframe, make_loop
store = MapStore.create(sys.argv[1])
for id_ in range(20):
    store.add(make_keyframe(id_), [], [make_loop(id_, 0)])
store._db.execute("BEGIN")
store._db.execute("DELETE FROM loops")
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_killed_run_keeps_every_keyframe_it_added(path: Path) -> None:
    here = str(Path(__file__).parent)
    killed = subprocess.run([sys.executable, "-c", KILLED, str(path), here], check=False)
    assert killed.returncode == -9
    with MapStore.open(path) as store:
        assert len(store.keyframes()) == len(store.loops()) == 20
    with MapStore.open(path, read_only=False) as store:
        store.add(make_keyframe(20))
        assert len(store.keyframes()) == 21


def test_a_new_map_does_not_overwrite_anything(path: Path) -> None:
    path.write_text("precious")
    with pytest.raises(MapError, match=r"map\.db: found a file, expected none"):
        MapStore.create(path)
    assert path.read_text() == "precious"
    with pytest.raises(MapError, match="cannot be opened"):
        MapStore.create(path.parent / "none" / "map.db")


def test_what_is_no_map_is_named(path: Path, tmp_path: Path) -> None:
    with pytest.raises(MapError, match=r"map\.db: found no file, expected a map\.db"):
        MapStore.open(path)
    with pytest.raises(MapError, match="found a folder"):
        MapStore.open(tmp_path)
    path.write_text("this is text, and long enough to be no database header " * 40)
    with pytest.raises(MapError, match="found no SQLite database"):
        MapStore.open(path)
    path.write_bytes(b"")
    with pytest.raises(MapError, match="found no map in this database"):
        MapStore.open(path)


def make_old(path: Path) -> None:
    """Turn a map into one of version 2, which knew no smoothed labels and no rooms."""
    db = sqlite3.connect(path)
    db.execute("DROP VIEW keyframe_labels")
    db.execute("DROP TABLE regions")
    for column in SMOOTHED:
        db.execute(f"ALTER TABLE keyframes DROP COLUMN {column}")
    db.execute("CREATE VIEW keyframe_labels AS SELECT id FROM keyframes")
    db.execute("PRAGMA user_version = 2")
    db.commit()
    db.close()


@pytest.mark.parametrize("read_only", [True, False])
def test_an_older_map_is_upgraded(path: Path, read_only: bool) -> None:
    with MapStore.create(path) as store:
        store.add(make_keyframe(0))
    make_old(path)
    before = path.read_bytes()
    with MapStore.open(path, read_only=read_only) as store:
        (keyframe,) = store.keyframes()
        assert keyframe.smoothed is None
        assert store.regions() == []
        ((region,),) = store.select("SELECT region FROM keyframe_labels")
        assert region is None
    assert (path.read_bytes() == before) == read_only
    with MapStore.open(path) as store:
        assert len(store.keyframes()) == 1


def test_smoothed_labels_and_rooms(path: Path) -> None:
    kitchen = Scene("kitchen", 0.7, CLASSES, np.array([0.7, 0.3]))
    unsure = Scene("unknown", 0.5, CLASSES, np.array([0.5, 0.5]))
    region = Region(0, "kitchen", 0.6, (0, 2), (0.0, 1.0, 2.0), (-1.0, 0.0, 1.0), (1.0, 2.0, 3.0))
    with MapStore.create(path) as store:
        store.add(replace(make_keyframe(0), smoothed=unsure))
        store.add(make_keyframe(1))
        store.add(make_keyframe(2))
        assert [k.smoothed and k.smoothed.label for k in store.keyframes()] == [
            "unknown", None, None,
        ]  # fmt: skip
        for _ in range(2):
            store.set_scenes([kitchen, None, unsure], [region])
        assert store.regions() == [region]
        first, second, third = store.keyframes()
        np.testing.assert_array_equal(first.smoothed.probabilities, kitchen.probabilities)
        assert (first.smoothed.label, first.smoothed.probability) == ("kitchen", 0.7)
        assert second.smoothed is None
        assert third.smoothed.label == "unknown"
        rows = store.select("SELECT smoothed, smoothed_probability, region FROM keyframe_labels")
        assert [tuple(row) for row in rows] == [
            ("kitchen", 0.7, 0), (None, None, None), ("unknown", 0.5, 0),
        ]  # fmt: skip
        with pytest.raises(ValueError, match="smoothed must have 3 labels, got 1"):
            store.set_scenes([kitchen], [])


def test_another_version_is_named(path: Path) -> None:
    MapStore.create(path).close()
    db = sqlite3.connect(path)
    db.execute(f"PRAGMA user_version = {SCHEMA_VERSION + 1}")
    db.close()
    with pytest.raises(MapError, match="found map version 4, expected 2 or 3"):
        MapStore.open(path)


def test_a_damaged_map_is_named(filled: MapStore, tmp_path: Path) -> None:
    filled.close()
    damaged = tmp_path / "damaged.db"
    content = bytearray(filled.path.read_bytes())
    content[4096:] = b"\xa5" * (len(content) - 4096)
    damaged.write_bytes(content)
    with MapStore.open(damaged) as store, pytest.raises(MapError, match="found a damaged"):
        store.keyframes()


def test_a_second_writer_is_told(filled: MapStore, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slam_bof.schema.BUSY_TIMEOUT_S", 0.05)
    with MapStore.open(filled.path, read_only=False) as second, filled._transaction():
        with pytest.raises(MapError, match="locked by another program") as caught:
            second.add(make_keyframe(6))
        assert "\n" not in str(caught.value)


def test_a_full_disk_is_named_and_loses_nothing(filled: MapStore) -> None:
    ((pages,),) = filled.select("PRAGMA page_count")
    filled.select(f"PRAGMA max_page_count = {pages}")
    with pytest.raises(MapError, match=r"map\.db: cannot be written: the disk is full"):
        filled.add(make_keyframe(6), cloud=np.zeros((50_000, 3)))
    assert len(filled.keyframes()) == 6


def test_a_finished_map_can_be_read_where_nothing_can_be_written(filled: MapStore) -> None:
    filled.close()
    folder = filled.path.parent / "medium"
    folder.mkdir()
    shutil.copy(filled.path, folder / "map.db")
    (folder / "map.db").chmod(0o400)
    folder.chmod(0o500)
    try:
        with MapStore.open(folder / "map.db") as store:
            assert len(store.keyframes()) == 6
        assert os.listdir(folder) == ["map.db"]
    finally:
        folder.chmod(0o700)


def test_a_loop_that_was_held_is_accepted_when_it_is_added(path: Path) -> None:
    held = Candidate(1, 0, "bag", decision="held", reason="no other agrees")
    other = Candidate(1, 0, "proximity", decision="rejected", reason="overlap")
    with MapStore.create(path) as store:
        store.add(make_keyframe(0))
        store.add(make_keyframe(1), [held, other])
        store.add(make_keyframe(2), [], [make_loop(1, 0)])
        assert [c.decision for c in store.candidates()] == ["accepted", "rejected"]


def test_a_loop_that_is_left_out_is_rejected_with_the_reason(path: Path) -> None:
    accepted = [Candidate(2, i, "view", decision="accepted") for i in (0, 1)]
    held = Candidate(1, 0, "view", decision="held", reason="no other agrees")
    loops = [replace(make_loop(2, i), source="view") for i in (0, 1)]
    with MapStore.create(path) as store:
        store.add(make_keyframe(0))
        store.add(make_keyframe(1), [held])
        store.add(make_keyframe(2), accepted, loops)
        store.leave_out(loops[1:], "contradicts the others")
        assert [(loop.query_id, loop.match_id) for loop in store.loops()] == [(2, 0)]
        assert [(c.decision, c.reason) for c in store.candidates()] == [
            ("held", "no other agrees"),
            ("accepted", ""),
            ("rejected", "contradicts the others"),
        ]
