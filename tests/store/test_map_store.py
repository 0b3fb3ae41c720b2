import json
from collections.abc import Iterator
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from saved_maps import (
    CAMERA,
    CLASSES,
    STATE,
    make_candidate,
    make_constellation,
    make_keyframe,
    make_loop,
    make_odometry,
    make_record,
    make_subsampled,
    save,
    save_six,
)

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.scenes import MapRoom
from slam_bof.store import (
    MapStore,
    Session,
    SessionResult,
    check_map,
    prune_map,
    replay_keyframes,
)
from slam_bof.store.pruning import drop_keyframes
from slam_bof.types import Bag, Candidate, CandidateSource, Decision, FramePose, Scene


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "map.db"


@pytest.fixture
def filled(path: Path) -> Iterator[MapStore]:
    """A map of 6 keyframes with a loop and a covisibility edge."""
    with MapStore.create(path) as store:
        rejected = Candidate(
            5, 3, CandidateSource.PROXIMITY, decision=Decision.REJECTED, reason="overlap 0.10"
        )
        edges = [make_loop(5, 0), make_loop(5, 4, "covisibility")]
        save_six(store, [make_candidate(5, 0), rejected], edges)
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
    first, second, _ = filled.candidates()
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
        save(store, keyframe, [candidate], [replace(make_loop(0, 0), match_id=np.int64(0))])
        assert store.candidates()[0].eta == 0.5
        assert store.loops()[0].match_id == 0


def test_a_keyframe_needs_no_label_and_an_empty_bag_is_one(path: Path) -> None:
    empty = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    with MapStore.create(path) as store:
        save(store, replace(make_keyframe(0, scene=False), bag=empty))
        (found,) = store.keyframes()
        assert found.scene is None
        assert found.bag.words.shape == (0,)
        assert store.classes() == ()


def test_depth_images_come_back_as_they_went_in(filled: MapStore) -> None:
    found = filled.view(5)
    assert found is not None
    assert (found.stamp_s, found.intrinsics) == (20 / 30.0, CAMERA)
    np.testing.assert_array_equal(found.depth, make_subsampled(5).depth)
    assert filled.intrinsics() == CAMERA
    assert filled.view(6) is None


def test_frames_come_back_to_the_bit(filled: MapStore) -> None:
    frames = filled.frames(0)
    assert [frame.stamp_s for frame in frames[-5:]] == [k / 30.0 for k in range(16, 21)]
    for id_ in range(6):
        np.testing.assert_array_equal(
            frames[4 * id_].T_odom_camera, make_keyframe(id_).T_odom_camera
        )
        assert frames[4 * id_].segment == id_ // 3
        assert frames[4 * id_].T_view_camera is None


def same_constellations(found: list[Any], expected: list[Any]) -> None:
    for back, saved in zip(found, expected, strict=True):
        np.testing.assert_array_equal(back.gravity_camera, saved.gravity_camera)
        for name in ("describer", "contours", "weight"):
            assert getattr(back, name) == getattr(saved, name)


def test_a_keyframe_needs_no_constellation(path: Path) -> None:
    with MapStore.create(path) as store:
        store.begin_session(Session(0, "7scenes", "room/seq-01", "", 0, "1.0"))
        store.write(replace(make_record(make_keyframe(0)), constellation=None))
        (record,) = replay_keyframes(store)
        assert store.constellation(0) is record.constellation is None
    assert check_map(path) == []


def test_constellations_go_with_their_keyframes_when_a_map_is_pruned(filled: MapStore) -> None:
    finish(filled)
    filled.close()
    assert prune_map(filled.path, lambda store: [1, 3]) == 2
    with MapStore.open(filled.path) as store:
        found = [store.constellation(id_) for id_ in range(4)]
        assert store.constellation(4) is None
    same_constellations(found, [make_constellation(id_) for id_ in (0, 2, 4, 5)])
    assert check_map(filled.path) == []


def test_the_newest_state_of_the_odometry_comes_back_to_the_bit(filled: MapStore) -> None:
    assert filled.odometry(0) is None
    for id_, state in ((6, make_odometry(24)), (7, make_odometry(28)), (8, None)):
        filled.write(make_record(make_keyframe(id_)), state)
    found = filled.odometry(0)
    assert found is not None
    assert found.frame_index == 28
    assert found.skipped.tolist() == [1, 3]
    assert found.arrays.keys() == {"points", "n"}
    np.testing.assert_array_equal(found.arrays["points"], make_odometry(28).arrays["points"])
    assert found.arrays["n"] == 7
    assert check_map(filled.path) == []


def test_the_state_of_the_odometry_goes_when_a_map_is_pruned(filled: MapStore) -> None:
    filled.write(make_record(make_keyframe(6)), make_odometry(24))
    keyframes = filled.keyframes()
    poses = np.array([keyframe.T_odom_camera for keyframe in keyframes])
    filled.finish(0, SessionResult([], poses, [k.smoothed for k in keyframes], []))
    filled.close()
    assert prune_map(filled.path, lambda store: [1, 3]) == 2
    with MapStore.open(filled.path) as store:
        assert store.odometry(0) is None
    assert check_map(filled.path) == []


def test_records_are_what_was_written(path: Path) -> None:
    """A held loop enters the graph with a later keyframe than the one that measured it."""
    held = make_candidate(1, 0, decision="held", reason="no other agrees")
    first, second = make_loop(1, 0), make_loop(2, 0)
    records = [
        make_record(make_keyframe(0)),
        replace(make_record(make_keyframe(1), [held]), measured=(first,)),
        make_record(make_keyframe(2), [make_candidate(2, 0)], [second, first]),
    ]
    with MapStore.create(path) as store:
        store.begin_session(Session(0, "7scenes", "room/seq-01", "", 0, "1.0"))
        for record in records:
            store.write(record)
        found = list(replay_keyframes(store))
    for record, back in zip(records, found, strict=True):
        np.testing.assert_array_equal(back.keyframe.T_odom_camera, record.keyframe.T_odom_camera)
        np.testing.assert_array_equal(back.depth.depth, record.depth.depth)
        assert len(back.frames) == len(record.frames)
        pairs = [[(loop.query_id, loop.match_id) for loop in r.admitted] for r in (back, record)]
        assert pairs[0] == pairs[1]
        same_constellations([back.constellation], [record.constellation])
        assert [loop.query_id for loop in back.measured] == [
            loop.query_id for loop in record.measured
        ]
        np.testing.assert_equal(
            [loop.information for loop in back.measured],
            [loop.information for loop in record.measured],
        )
    assert found[-1].state == STATE


def finish(store: MapStore, **given: object) -> None:
    """End the session of a map of ``filled``'s keyframes."""
    n = len(store.keyframes())
    result = SessionResult([], np.tile(np.eye(4), (n, 1, 1)), [None] * n, [])
    store.finish(0, replace(result, **given))


def test_map_poses_are_nan_until_the_session_is_finished(filled: MapStore) -> None:
    assert np.isnan(filled.map_poses()).all()
    poses = se3.exp(np.random.default_rng(0).normal(size=(6, 6)))
    finish(filled, T_map_camera=poses)
    np.testing.assert_allclose(filled.map_poses(), poses, atol=2e-15)
    assert [session.is_finished for session in filled.sessions()] == [True]
    with pytest.raises(ValueError, match=r"poses must be \(6, 4, 4\)"):
        finish(filled, T_map_camera=poses[:5])


def test_the_frames_after_the_last_keyframe_come_with_the_end(filled: MapStore) -> None:
    T = np.eye(4)
    for n in (2, 1):  # a run that was resumed at its very end says it again
        finish(filled, frames=[FramePose(1.0 + k, T, T, -1) for k in range(n)])
        assert [frame.segment for frame in filled.frames(0)[21:]] == [-1] * n


def test_the_covariance_of_a_step_is_kept_with_its_frame(filled: MapStore) -> None:
    T, covariance = np.eye(4), np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4])
    frames = [FramePose(1.0, T, T, 0), FramePose(2.0, T, T, 0, step_covariance=covariance)]
    finish(filled, frames=frames)
    without, found = filled.frames(0)[21:]
    assert without.step_covariance is None
    np.testing.assert_array_equal(found.step_covariance, covariance)


def test_parameters(filled: MapStore) -> None:
    filled.set_parameters({"seed": 3, "dataset": "7scenes", "model": None})
    filled.set_parameters({"seed": 4})
    found = filled.parameters()
    assert json.loads(found.pop("camera")) == asdict(CAMERA)
    assert found == {
        "seed": "4", "dataset": "7scenes", "model": "null", "classes": '["kitchen", "office"]',
    }  # fmt: skip
    assert filled.classes() == CLASSES


@pytest.mark.parametrize(
    ("candidates", "loops"),
    [([make_candidate(6, 99)], []), ([make_candidate(6, 0)], [make_loop(6, 99)])],
)
def test_a_keyframe_is_added_wholly_or_not_at_all(filled: MapStore, candidates, loops) -> None:
    with pytest.raises(ValueError, match="FOREIGN KEY"):
        save(filled, make_keyframe(6), candidates, loops)
    assert [len(x) for x in (filled.keyframes(), filled.candidates(), filled.loops())] == [6, 3, 2]
    save(filled, make_keyframe(6))
    assert len(filled.keyframes()) == 7


def test_a_keyframe_is_added_once(filled: MapStore) -> None:
    with pytest.raises(ValueError, match="UNIQUE"):
        save(filled, make_keyframe(5))


def test_scene_classes_stay_what_they_are(filled: MapStore) -> None:
    keyframe = make_keyframe(6)
    assert keyframe.scene is not None
    other = replace(keyframe.scene, classes=("bath", "hall"))
    with pytest.raises(ValueError, match="must stay"):
        save(filled, replace(keyframe, scene=other))


def test_the_views_are_readable(filled: MapStore) -> None:
    finish(filled)
    labels = filled.select("SELECT * FROM keyframe_labels")
    assert [row["scene"] for row in labels] == ["kitchen", "office"] * 3
    assert [row["n_loops"] for row in labels] == [0, 0, 0, 0, 0, 1]
    assert {(row["x_m"], row["y_m"], row["z_m"]) for row in labels} == {(0.0, 0.0, 0.0)}
    accepted, rejected, _ = filled.select("SELECT * FROM loop_audit")
    assert (accepted["decision"], accepted["eta"], accepted["match_stamp_s"]) == (
        "accepted",
        0.5,
        0,
    )
    assert (rejected["source"], rejected["reason"]) == ("proximity", "overlap 0.10")


def test_smoothed_labels_and_rooms(path: Path) -> None:
    kitchen = Scene("kitchen", 0.7, CLASSES, np.array([0.7, 0.3]))
    unsure = Scene("unknown", 0.5, CLASSES, np.array([0.5, 0.5]))
    room = MapRoom(0, "kitchen", 0.6, (0, 2), (0.0, 1.0, 2.0), (-1.0, 0.0, 1.0), (1.0, 2.0, 3.0))
    with MapStore.create(path) as store:
        save(store, replace(make_keyframe(0), smoothed=unsure))
        save(store, make_keyframe(1))
        save(store, make_keyframe(2))
        assert [k.smoothed and k.smoothed.label for k in store.keyframes()] == [
            "unknown", None, None,
        ]  # fmt: skip
        for _ in range(2):
            finish(store, smoothed=[kitchen, None, unsure], rooms=[room])
        assert store.rooms() == [room]
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
            finish(store, smoothed=[kitchen])


def test_a_loop_that_was_held_is_accepted_when_it_is_added(path: Path) -> None:
    held = Candidate(1, 0, CandidateSource.BAG, decision=Decision.HELD, reason="no other agrees")
    other = Candidate(1, 0, CandidateSource.PROXIMITY, decision=Decision.REJECTED, reason="overlap")
    with MapStore.create(path) as store:
        save(store, make_keyframe(0))
        record = make_record(make_keyframe(1), [held, other])
        store.write(replace(record, measured=(make_loop(1, 0),)))
        save(store, make_keyframe(2), [], [make_loop(1, 0)])
        assert [c.decision for c in store.candidates()] == ["accepted", "rejected"]


def test_a_loop_that_is_left_out_is_rejected_with_the_reason(path: Path) -> None:
    accepted = [Candidate(2, i, CandidateSource.VIEW, decision=Decision.ACCEPTED) for i in (0, 1)]
    held = Candidate(1, 0, CandidateSource.VIEW, decision=Decision.HELD, reason="no other agrees")
    loops = [replace(make_loop(2, i), source="view") for i in (0, 1)]
    with MapStore.create(path) as store:
        save(store, make_keyframe(0))
        save(store, make_keyframe(1), [held])
        save(store, make_keyframe(2), accepted, loops)
        for _ in range(2):
            finish(store, left_out=loops[1:], reason="contradicts the others")
        assert [(loop.query_id, loop.match_id) for loop in store.loops()] == [(2, 0)]
        assert [(c.decision, c.reason) for c in store.candidates()] == [
            ("held", "no other agrees"),
            ("accepted", ""),
            ("rejected", "contradicts the others"),
        ]


def test_an_anchor_that_was_culled_is_named(path: Path) -> None:
    with MapStore.create(path) as store:
        for id_ in range(5):
            save(store, make_keyframe(id_))
        store.write(replace(make_record(make_keyframe(5)), culled=((2, 0), (3, 2))))
        with pytest.raises(MapError, match="found keyframe 2, which was culled, as the anchor of"):
            list(replay_keyframes(store))


def test_culled_keyframes_come_back_with_the_keyframe_that_they_were_culled_by(
    path: Path,
) -> None:
    with MapStore.create(path) as store:
        for id_ in range(5):
            save(store, make_keyframe(id_))
        store.write(replace(make_record(make_keyframe(5)), culled=((2, 0), (3, 1))))
        assert store.anchors().tolist() == [0, 1, 0, 1, 4, 5]
    with MapStore.open(path) as store:
        culled = [record.culled for record in replay_keyframes(store)]
    assert culled == [(), (), (), (), (), ((2, 0), (3, 1))]
    assert check_map(path) == []
    with MapStore.open(path, read_only=False) as store:
        with store.transaction() as db:
            drop_keyframes(db, {1, 4})  # the anchor of 3 goes, so that it is in use again
        assert store.anchors().tolist() == [0, 0, 2, 3]
    assert check_map(path) == []
