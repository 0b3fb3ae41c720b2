"""Keyframes that show nothing new are let go of, and nothing that others rely on is lost."""

from dataclasses import replace

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.loops import ViewLoopDetector
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.config import override
from slam_bof.slam.keyframe_culling import KeyframeCulling, MapParams
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.store import MapStore, Session, replay_keyframes
from slam_bof.types import Bag, CandidateSource, EdgeKind, Keyframe, Loop
from slam_bof_plugins.backend_gtsam import GtsamBackend

N_ROUND, N_ROUNDS = 9, 5
CONFIG = override(
    preset("indoor"),
    ["map.every=4", "map.n_views=2", "keyframes.policy=every", "keyframes.every=1"],
)
NO_WORDS = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def around(x_m, y_m, z_m, n_rounds=N_ROUNDS):
    """Return poses (n, 4, 4) of rounds on the spot, a keyframe apart."""
    yaws = np.tile(0.21 * np.arange(N_ROUND), n_rounds)
    c, s, o, i = np.cos(yaws), np.sin(yaws), np.zeros(len(yaws)), np.ones(len(yaws))
    rows = [[s, o, c, x_m * i], [-c, o, s, y_m * i], [o, -i, o, z_m * i], [o, o, o, i]]
    return np.moveaxis(np.array(rows), -1, 0)


@pytest.fixture(scope="module")
def tour(look, standpoint):
    """Frames of five looks about, to and fro with seconds between them, and their poses."""
    poses = around(*standpoint, 1.3).reshape(N_ROUNDS, N_ROUND, 4, 4)
    poses[1::2] = poses[1::2, ::-1].copy()
    poses = poses.reshape(-1, 4, 4)
    frames = [
        replace(look(T, k), stamp_s=k / 10 + 4.0 * (k // N_ROUND)) for k, T in enumerate(poses)
    ]
    return frames, se3.inverse(poses[0]) @ poses


@pytest.fixture(scope="module")
def culled(tour):
    """The loop closer after all of it, how many keyframes it used after each, and its records."""
    records, in_use = [], []
    closer = LoopCloser.from_config(CONFIG, journal=records.append)
    for frame, T in zip(*tour, strict=True):
        closer.process(frame, T)
        in_use.append(len(closer.map.in_use))
    return closer, in_use, records


def test_a_place_that_is_known_stops_growing(culled):
    closer, in_use, _ = culled
    assert len(closer.map) == N_ROUNDS * N_ROUND
    assert in_use[-1] < 0.8 * len(closer.map)
    assert in_use[-1] < in_use[3 * N_ROUND] + N_ROUND  # which was nearly two rounds earlier


def test_every_frame_has_its_pose_all_the_same(tour, culled):
    trajectory = culled[0].finish()
    assert len(trajectory) == len(tour[0])
    off = se3.inverse(tour[1]) @ trajectory.poses
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() < 0.02
    assert culled[0].map.poses().shape == (len(tour[0]), 4, 4)


def test_the_oldest_stay_and_anchors_are_never_culled(culled):
    closer, _, records = culled
    pairs = [pair for record in records for pair in record.culled]
    gone, anchors = map(set, zip(*pairs, strict=True))
    assert not gone & anchors
    in_use = set(closer.map.in_use.tolist())
    assert in_use == set(range(len(closer.map))) - gone
    assert set(range(N_ROUND)) <= in_use
    poses = closer.map.poses()
    for keyframe_id, anchor in pairs:
        T = se3.inverse(poses[anchor]) @ poses[keyframe_id]
        assert anchor < keyframe_id
        assert np.linalg.norm(T[:3, 3]) < 0.25
        assert se3.rotation_angle(T) < 0.25


def test_nothing_is_culled_while_a_loop_may_wait_for_others(culled):
    window = CONFIG.verification.consistency.window
    for record in culled[2]:
        for keyframe_id, _ in record.culled:
            assert record.keyframe.id - keyframe_id > window


def test_culled_keyframes_are_not_looked_for_and_their_loops_still_count(culled):
    closer, _, records = culled
    gone = set()
    for record in records:
        assert not gone & {candidate.match_id for candidate in record.candidates}
        gone |= {keyframe_id for keyframe_id, _ in record.culled}
    admitted = [loop for record in records for loop in record.admitted]
    loops = closer.map.loops + closer.map.loops_left_out
    assert {(loop.query_id, loop.match_id, loop.kind) for loop in loops} == {
        (loop.query_id, loop.match_id, loop.kind) for loop in admitted
    }
    found = {(loop.query_id, loop.match_id): loop for loop in loops}
    for loop in admitted:
        same = found[loop.query_id, loop.match_id]
        np.testing.assert_array_equal(same.T_match_query, loop.T_match_query)
        is_gone = loop.query_id in gone or loop.match_id in gone
        assert same.information.any() != is_gone


def test_an_interrupted_run_goes_on_as_if_it_had_not_been(tour, culled, tmp_path):
    whole, _, records = culled
    n_frames = 4 * N_ROUND
    path = tmp_path / "map.db"
    with MapStore.create(path) as store:
        store.begin_session(Session(id=0, dataset="test", sequence="rounds"))
        for record in records[:n_frames]:
            store.write(record)
    again = []
    with MapStore.open(path) as store:
        resumed = LoopCloser.from_config(CONFIG, journal=again.append)
        resumed.restore(replay_keyframes(store))
        anchors = store.anchors()
    assert (anchors != np.arange(n_frames)).any()
    np.testing.assert_array_equal(resumed.map.anchors, anchors)
    for frame, T in zip(tour[0][n_frames:], tour[1][n_frames:], strict=True):
        resumed.process(frame, T)
    assert any(record.culled for record in again)
    for one, other in zip(again, records[n_frames:], strict=True):
        assert one.culled == other.culled
        assert one.state == other.state
        assert [c.match_id for c in one.candidates] == [c.match_id for c in other.candidates]
    for closer in (whole, resumed):
        closer.finish()
    np.testing.assert_allclose(resumed.map.poses(), whole.map.poses(), atol=1e-9)


def test_culling_happens_whole_or_not_at_all(tour, culled, monkeypatch):
    """The first time, half of it has happened when something goes wrong."""
    records = culled[2]
    n_frames = next(k for k, record in enumerate(records) if record.culled) + 3
    again = []
    closer = LoopCloser.from_config(CONFIG, journal=again.append)
    remove = ViewLoopDetector.remove

    def fail(detector, keyframe_ids):
        monkeypatch.undo()
        remove(detector, keyframe_ids)
        raise MemoryError

    monkeypatch.setattr(ViewLoopDetector, "remove", fail)
    n_failed = 0
    for frame, T in zip(tour[0][:n_frames], tour[1], strict=False):
        try:
            closer.process(frame, T)
        except MemoryError:
            n_failed += 1
            assert len(closer.map.in_use) == len(closer.map) == len(again)
            closer.process(frame, T)
    assert n_failed == 1
    for one, other in zip(again, records, strict=False):
        assert [id_ for id_, _ in one.culled] == [id_ for id_, _ in other.culled]
        assert [c.match_id for c in one.candidates] == [c.match_id for c in other.candidates]
    gone = {keyframe_id for record in again for keyframe_id, _ in record.culled}
    assert set(closer.map.in_use.tolist()) == set(range(n_frames)) - gone


def poses_of_rounds():
    """Return poses (n, 4, 4) of three rounds, 4 mm and 0.004 rad apart."""
    aside = se3.exp(0.004 * np.outer(np.repeat([0, 1, 2], N_ROUND), [0, 1, 0, 1, 0, 0]))
    return around(0.0, 0.0, 0.0, 3) @ aside


def known_graph(slip_m=0.0):
    """Return the graph of three rounds, with loops to all rounds before.

    One loop of the last round, the oldest of its keyframe, is off by ``slip_m``.
    """
    poses = poses_of_rounds()
    graph = MapGraph(GtsamBackend())
    slipped = se3.pose(np.eye(3), [slip_m, 0.0, 0.0])
    for k, T in enumerate(poses):
        graph.add_keyframe(Keyframe(k, k, 5.0 * k, T, NO_WORDS, None))
        loops = [
            Loop(
                k,
                match,
                se3.inverse(poses[match])
                @ T
                @ (slipped if (k, match) == (2 * N_ROUND + 4, 4) else np.eye(4)),
                100.0 * np.eye(6),
                EdgeKind.LOOP,
                CandidateSource.VIEW,
            )
            for match in range(k % N_ROUND, k, N_ROUND)
        ]
        graph.add_loops(loops)
    return graph


N_DUE = 2 * N_ROUND - 9
"""Keyframes after the first round that are older than the window."""


@pytest.mark.parametrize(
    ("params", "n_culled"),
    [
        ({"n_views": 1}, N_DUE),
        ({"n_views": 2}, 0),  # the third round is not due
        ({"n_views": 1, "same_m": 0.002}, 0),
        ({"n_views": 1, "same_rad": 0.002}, 0),
        ({"n_views": 1, "every": 19}, N_DUE),
        ({"n_views": 1, "every": 20}, 0),
        ({"n_views": 9, "large": 27, "n_views_large": 1}, N_DUE),
        ({"n_views": 9, "large": 28, "n_views_large": 1}, 0),
        ({"n_views": 2, "same_rad": 0.3}, N_DUE),
    ],
)
def test_the_choice_follows_its_parameters(params, n_culled):
    graph = known_graph()
    params = MapParams(**({"every": 2} | params))
    culling = KeyframeCulling(params, window=8, max_distance_m=0.1, max_angle_rad=0.06)
    culling.undecided = list(range(3 * N_ROUND))
    anchors = culling.choose(graph, waiting=())
    culled = {k: anchor for k, anchor in anchors.items() if k >= N_ROUND}
    assert len(anchors) == len(culled) == n_culled
    assert all(anchor % N_ROUND == k % N_ROUND for k, anchor in anchors.items())
    assert not set(anchors) & set(anchors.values())
    graph.cull(anchors, params.max_edges)
    graph.optimize()
    assert len(graph.backend.poses()) == len(graph.in_use) == 3 * N_ROUND - n_culled
    np.testing.assert_allclose(graph.poses(), poses_of_rounds(), atol=1e-3)


def test_the_larger_the_map_the_rarer_the_choice():
    """Of 27 keyframes in use, an eighth has to be due beside those in the window."""
    graph = known_graph()
    culling = KeyframeCulling(
        MapParams(n_views=1, every=1), window=8, max_distance_m=0.1, max_angle_rad=0.06
    )
    culling.undecided = list(range(17, 27))
    assert culling.choose(graph, waiting=()) == {}
    culling.undecided = list(range(16, 27))
    assert set(culling.choose(graph, waiting=())) == {16, 17}


def culling_of(n_views):
    params = MapParams(n_views=n_views, every=1)
    culling = KeyframeCulling(params, window=1, max_distance_m=0.1, max_angle_rad=0.06)
    culling.undecided = list(range(N_ROUND, 3 * N_ROUND))
    return culling


def test_what_waits_is_decided_later():
    culling, waiting = culling_of(n_views=1), N_ROUND + 2
    anchors = culling.choose(known_graph(), waiting={waiting})
    assert waiting - 1 in anchors
    assert waiting not in anchors
    assert waiting in culling.undecided


def test_what_the_map_contradicts_is_kept_unless_twice_as_many_show_the_same():
    graph, slipped = known_graph(slip_m=0.3), 2 * N_ROUND + 4
    culling = culling_of(n_views=2)
    anchors = culling.choose(graph, waiting=())
    assert slipped - 1 in anchors
    assert slipped not in anchors
    assert slipped not in culling.undecided
    culling = culling_of(n_views=1)
    culling.undecided = [slipped - 1, slipped, *range(slipped + 1, 3 * N_ROUND)]
    anchors = culling.choose(graph, waiting=())
    assert anchors[slipped - 1] in (3, N_ROUND + 3)
    assert anchors[slipped] == N_ROUND + 4  # its loop to the other, 4, is the one that is off


@pytest.mark.parametrize(
    "config", [preset("paper"), override(CONFIG, ["map.cull=false"])], ids=["bags", "off"]
)
def test_nothing_is_culled_or_remembered_for_it_where_it_is_off(tour, config):
    closer = LoopCloser.from_config(config)
    closer.process(tour[0][0], tour[1][0])
    assert closer.map.cull() == ()
    assert closer.map.state()["undecided"] == []
