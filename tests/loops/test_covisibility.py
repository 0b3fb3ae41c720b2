import numpy as np
import pytest

from slam_bof.geometry import se3, view_overlap
from slam_bof.loops import CovisibilityParams, choose_covisible, find_covisible
from slam_bof.types import Bag, CandidateSource, EdgeKind, Intrinsics, Keyframe

CAMERA = Intrinsics(width=640, height=480, fx=585.0, fy=585.0, cx=320.0, cy=240.0)


@pytest.fixture
def wall():
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-0.7, 0.7, 15))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1)


def overlap_after(motion, points, max_range_m=5.0):
    others = np.stack([motion])
    return view_overlap(points, np.eye(4), others, CAMERA, max_range_m)[0]


def test_same_view_overlaps_wholly(wall):
    assert overlap_after(np.eye(4), wall) == 1.0


def test_view_from_behind_does_not_overlap(wall):
    turned = se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))
    assert overlap_after(turned, wall) == 0.0


def test_half_a_view_aside_halves_the_overlap(wall):
    aside = se3.pose(np.eye(3), [1.05, 0.0, 0.0])
    assert overlap_after(aside, wall) == pytest.approx(0.5, abs=0.05)


def test_surfaces_out_of_range_do_not_count(wall):
    back = se3.pose(np.eye(3), [0.0, 0.0, -2.0])
    assert overlap_after(back, wall, max_range_m=5.0) == 1.0
    assert overlap_after(back, wall, max_range_m=3.0) == 0.0


def test_overlap_does_not_depend_on_the_map_frame(wall):
    T_world_map = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
    other = se3.exp(np.array([0.1, 0.2, 0.0, 0.3, 0.0, 0.1]))
    here = view_overlap(wall, np.eye(4), other[None], CAMERA, 5.0)
    there = view_overlap(wall, T_world_map, (T_world_map @ other)[None], CAMERA, 5.0)
    assert here == pytest.approx(there)


@pytest.mark.parametrize("n_others", [0, 3])
def test_empty_input_gives_no_overlap(n_others):
    others = np.tile(np.eye(4), (n_others, 1, 1))
    overlaps = view_overlap(np.empty((0, 3)), np.eye(4), others, CAMERA, 5.0)
    assert overlaps.shape == (n_others,)
    assert not overlaps.any()


def test_the_best_are_chosen_apart_from_each_other_and_bounded():
    overlaps = np.array([0.5, 0.8, 0.7, 0.2, 0.6, 0.9, 0.95])
    apart = CovisibilityParams(min_overlap=0.35, separation=2)
    ids = np.arange(7)
    assert choose_covisible(ids, overlaps, apart) == [1, 4, 6]
    assert choose_covisible(ids, overlaps, apart.model_copy(update={"max_edges": 2})) == [1, 6]
    # Keyframes between 4 and 9 were culled.
    assert choose_covisible(np.array([0, 1, 2, 3, 4, 9, 10]), overlaps, apart) == [1, 4, 10]
    assert choose_covisible(np.array([0, 1, 2, 3, 4, 9, 20]), overlaps, apart) == [1, 4, 9, 20]
    np.testing.assert_array_equal(overlaps[:2], [0.5, 0.8])  # the input is left alone


def test_no_edges_when_turned_off_or_nothing_overlaps():
    ids = np.arange(5)
    assert choose_covisible(ids, np.full(5, 0.9), CovisibilityParams(max_edges=0)) == []
    assert choose_covisible(ids, np.full(5, 0.1), CovisibilityParams()) == []


def test_pairs_are_loops_with_older_keyframes_and_other_sessions(wall):
    """Five keyframes of one view: of another session, culled, old, young and the newest."""
    nothing = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    keyframes = [
        Keyframe(k, k, stamp_s, np.eye(4), nothing, None, session=session)
        for k, (stamp_s, session) in enumerate([(0.0, 0), (1.0, 1), (2.0, 1), (9.0, 1), (10.0, 1)])
    ]
    found = find_covisible(
        keyframes,
        wall,
        CAMERA,
        np.tile(np.eye(4), (5, 1, 1)),
        np.array([0, -1, 0, 0, 0]),
        CovisibilityParams(separation=1),
        min_age_s=5.0,
    )
    assert [(c.query_id, c.match_id, c.kind) for c in found] == [
        (4, 0, EdgeKind.LOOP),
        (4, 2, EdgeKind.LOOP),
        (4, 3, EdgeKind.COVISIBILITY),
    ]
    assert {c.source for c in found} == {CandidateSource.PROXIMITY}


def test_a_keyframe_of_another_session_is_older_whatever_its_clock(wall):
    nothing = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
    keyframes = [
        Keyframe(k, k, stamp_s, np.eye(4), nothing, None, session=k)
        for k, stamp_s in enumerate([100.0, 1.0])
    ]
    (pair,) = find_covisible(
        keyframes,
        wall,
        CAMERA,
        np.tile(np.eye(4), (2, 1, 1)),
        np.zeros(2, np.int64),
        CovisibilityParams(),
        min_age_s=5.0,
    )
    assert pair.kind == EdgeKind.LOOP
