import json
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from saved_maps import save

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.scenes import MapRoom
from slam_bof.store import MapStore, SessionResult, query_keyframes, query_loops, query_rooms
from slam_bof.store.sqlite import update_checksums
from slam_bof.types import Bag, CandidateSource, EdgeKind, Keyframe, Loop, Scene

CLASSES = ("kitchen", "office")
PROBABILITIES = [0.9, 0.6, 0.3, 0.1]


@pytest.fixture
def store(tmp_path: Path) -> Iterator[MapStore]:
    """Four keyframes one second and one metre apart: two of a kitchen, two of an office."""
    with MapStore.create(tmp_path / "map.db") as store:
        for id_, p in enumerate(PROBABILITIES):
            scene = Scene(CLASSES[p < 0.5], max(p, 1 - p), CLASSES, np.array([p, 1 - p]))
            T = se3.pose(np.eye(3), [float(id_), 0.0, 0.0])
            bag = Bag(np.array([id_], np.int32), np.ones(1, np.float32))
            edges = {
                2: [Loop(2, 0, np.eye(4), np.eye(6), EdgeKind.LOOP, CandidateSource.BAG)],
                3: [
                    Loop(3, 0, T, np.eye(6), EdgeKind.LOOP, CandidateSource.PROXIMITY),
                    Loop(3, 1, T, np.eye(6), EdgeKind.PARTIAL, CandidateSource.PROXIMITY),
                    Loop(3, 2, T, np.eye(6), EdgeKind.COVISIBILITY, CandidateSource.PROXIMITY),
                ],
            }
            keyframe = Keyframe(id_, 30 * id_, 100.0 + id_, T, bag, scene)
            save(store, keyframe, [], edges.get(id_, []), n_frames=1)
        yield store


def ids(records) -> list[int]:
    return [record.id for record in records]


def test_all_keyframes_in_order(store: MapStore) -> None:
    assert ids(query_keyframes(store)) == [0, 1, 2, 3]
    assert ids(query_keyframes(store, limit=2)) == [0, 1]


def test_the_nearest_in_time(store: MapStore) -> None:
    records = query_keyframes(store, time_s=101.8, limit=2)
    assert ids(records) == [2, 1]
    assert [r.apart_s for r in records] == pytest.approx([0.2, 0.8])


def test_the_nearest_in_space(store: MapStore) -> None:
    records = query_keyframes(store, near_m=(2.9, 0.0, 1.0), limit=2)
    assert ids(records) == [3, 2]
    assert records[0].distance_m == pytest.approx(np.hypot(0.1, 1.0))


def test_by_scene_and_probability(store: MapStore) -> None:
    assert ids(query_keyframes(store, scene="kitchen")) == [0, 1]
    assert ids(query_keyframes(store, scene="kitchen", min_probability=0.8)) == [0]
    assert ids(query_keyframes(store, scene="office", time_s=0.0)) == [2, 3]


def smoothed(label: str, p: float) -> Scene:
    return Scene(label, max(p, 1 - p), CLASSES, np.array([p, 1 - p]))


@pytest.fixture
def rooms(store: MapStore) -> MapStore:
    """The same, with smoothed labels of which one differs, and two rooms."""
    labels = [("kitchen", 0.9), ("kitchen", 0.8), ("kitchen", 0.7), ("unknown", 0.5)]
    box = ((1.0, 0.0, 0.0),) * 3
    rooms = [MapRoom(0, "kitchen", 0.6, (0, 1), *box), MapRoom(1, "kitchen", 0.7, (2,), *box)]
    poses = np.array([keyframe.T_odom_camera for keyframe in store.keyframes()])
    store.finish(0, SessionResult([], poses, [smoothed(*label) for label in labels], rooms))
    return store


def test_smoothed_labels_go_before_raw_ones(rooms: MapStore) -> None:
    assert ids(query_keyframes(rooms, scene="kitchen")) == [0, 1, 2]
    assert ids(query_keyframes(rooms, scene="kitchen", labels="raw")) == [0, 1]
    assert ids(query_keyframes(rooms, scene="kitchen", min_probability=0.75)) == [0, 1]
    assert ids(query_keyframes(rooms, scene="unknown")) == [3]
    assert query_keyframes(rooms, scene="office") == []
    (record,) = query_keyframes(rooms, keyframe_id=2)
    assert (record.scene, record.smoothed, record.region) == ("office", "kitchen", 1)
    assert record.smoothed_probability == 0.7


def test_a_probability_may_be_asked_for_without_a_scene(rooms: MapStore) -> None:
    assert ids(query_keyframes(rooms, min_probability=0.65)) == [0, 1, 2]
    assert query_keyframes(rooms, keyframe_id=3, min_probability=0.65) == []


def test_where_the_kitchen_is(rooms: MapStore) -> None:
    assert ids(query_rooms(rooms)) == [0, 1]
    assert ids(query_rooms(rooms, scene="kitchen")) == [1, 0], "the most probable first"
    assert ids(query_rooms(rooms, min_probability=0.65)) == [1]
    assert query_rooms(rooms, scene="office") == []
    with pytest.raises(MapError, match="found no scene 'attic'"):
        query_rooms(rooms, scene="attic")


def test_one_keyframe_with_all_that_is_known_of_it(store: MapStore) -> None:
    (record,) = query_keyframes(store, keyframe_id=3)
    assert asdict(record) == {
        "id": 3,
        "component": 0,
        "frame_index": 90,
        "stamp_s": 103.0,
        "scene": "office",
        "scene_probability": 0.9,
        "smoothed": None,
        "smoothed_probability": None,
        "region": None,
        "frame": "odom",
        "translation_m": (3.0, 0.0, 0.0),
        "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0),
        "n_loops": 1,
        "probabilities": {"office": 0.9, "kitchen": 0.1},
        "apart_s": None,
        "distance_m": None,
    }
    assert list(record.probabilities) == ["office", "kitchen"]


def test_poses_are_those_of_the_map_once_there_are_any(store: MapStore) -> None:
    poses = se3.exp(np.zeros((4, 6))) + np.eye(4, k=3)[None]
    store.finish(0, SessionResult([], poses, [None] * 4, []))
    (record,) = query_keyframes(store, keyframe_id=3)
    assert (record.frame, record.translation_m) == ("map", (1.0, 0.0, 0.0))


def test_loops_without_covisibility(store: MapStore) -> None:
    assert [(r.query_id, r.match_id) for r in query_loops(store)] == [(2, 0), (3, 0)]
    (record,) = query_loops(store, keyframe_id=2)
    assert (record.query_stamp_s, record.match_stamp_s, record.source) == (102.0, 100.0, "bag")
    assert len(query_loops(store, keyframe_id=0)) == 2
    assert query_loops(store, keyframe_id=1) == []


def test_a_damaged_edge_is_named_if_the_answer_needs_it(store: MapStore) -> None:
    with store.transaction() as db:
        db.execute("UPDATE candidates SET query_id = 2 WHERE kind = 'covisibility'")
    assert [record.n_loops for record in query_keyframes(store)] == [0, 0, 1, 1]
    with store.transaction() as db:  # now that edge may join two components
        db.execute("UPDATE keyframes SET segment = 1 WHERE id = 3")
        update_checksums(db, "keyframes")
    with pytest.raises(MapError, match="damaged row of candidates, 4"):
        query_keyframes(store)


@pytest.mark.parametrize("change", ["kind = 'lopp'", "query_id = 1", "match_id = 1"])
def test_a_damaged_loop_is_never_counted(store: MapStore, change: str) -> None:
    with store.transaction() as db:
        db.execute(f"UPDATE candidates SET {change} WHERE kind = 'loop' AND query_id = 2")
    with pytest.raises(MapError, match="damaged row of candidates, 1"):
        query_keyframes(store)


def test_records_turn_into_json(store: MapStore) -> None:
    records = [*query_keyframes(store, near_m=[0, 0, 0]), *query_loops(store)]
    assert json.loads(json.dumps([asdict(record) for record in records]))


def test_what_the_map_has_not_got_is_named(store: MapStore) -> None:
    with pytest.raises(MapError, match="found no keyframe 4, expected 0 to 3"):
        query_keyframes(store, keyframe_id=4)
    with pytest.raises(
        MapError, match="found no scene 'attic', expected one of: kitchen, office, unknown"
    ):
        query_keyframes(store, scene="attic")


def test_an_empty_map_has_no_keyframes(tmp_path: Path) -> None:
    with MapStore.create(tmp_path / "empty.db") as store:
        assert query_keyframes(store, time_s=1.0) == []
        assert query_loops(store) == []
        with pytest.raises(MapError, match="none, it has no labels"):
            query_keyframes(store, scene="kitchen")
