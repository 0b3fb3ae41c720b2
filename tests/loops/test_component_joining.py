"""What it takes to join two parts of a map."""

import numpy as np
import pytest

from slam_bof.geometry import Agreement, se3
from slam_bof.loops.component_joining import ComponentJoiningGate, ComponentJoiningParams
from slam_bof.types import CandidateSource, EdgeKind, Loop

N = 12
PARTS = np.repeat([0, 1], N)


def turned(yaw, x=0.0):
    return se3.exp(np.array([0.0, yaw, 0.0, 0.0, 0.0, 0.0])) @ se3.pose(np.eye(3), [x, 0.0, 0.0])


@pytest.fixture
def looked_about():
    """Twelve views over 110 degrees, and the same again in a frame of their own."""
    truth = np.array([turned(np.radians(10.0 * i), 0.02 * i) for i in range(N)])
    return np.concatenate([truth, turned(1.0, 7.0) @ truth])


@pytest.fixture
def walked_down():
    """Twelve views along a straight hall of 2.2 m, and the same again."""
    truth = np.array([se3.pose(np.eye(3), [0.0, 0.0, 0.2 * i]) for i in range(N)])
    return np.concatenate([truth, turned(1.0, 7.0) @ truth])


def loop(poses, i, wrong=None):
    """Keyframe 12 + i stands where keyframe i does."""
    T = np.eye(4) if wrong is None else wrong
    return Loop(N + i, i, T, np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW)


class Compare:
    """Finds so much of a view blocking, and remembers what it was asked."""

    def __init__(self, free_space_violation=lambda query_id: 0.0):
        self.free_space_violation = free_space_violation
        self.asked = set()

    def __call__(self, query_id, match_ids, T_match_query):
        self.asked.add(query_id)
        ones = np.ones(len(match_ids))
        return Agreement(ones, self.free_space_violation(query_id) * ones, ones)


def admit(gate, loops, poses, components=PARTS):
    return [
        (found.query_id - N, found.match_id)
        for one in loops
        for found in gate.admit([one], poses, components)
    ]


def test_enough_loops_that_agree_join_all_at_once(looked_about):
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    loops = [loop(looked_about, i) for i in (0, 3, 6, 9, 10)]
    assert admit(gate, loops[:3], looked_about) == []
    assert admit(gate, loops[3:4], looked_about) == [(0, 0), (3, 3), (6, 6), (9, 9)]
    assert admit(gate, loops[4:], looked_about, np.zeros(2 * N, int)) == []


def test_one_that_disagrees_is_not_taken_along(looked_about):
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    wrong = loop(looked_about, 5, wrong=se3.pose(np.eye(3), [0.6, 0.0, 0.0]))
    loops = [loop(looked_about, 0), wrong, *(loop(looked_about, i) for i in (6, 8, 11))]
    assert admit(gate, loops, looked_about) == [(0, 0), (6, 6), (8, 8), (11, 11)]


def test_views_down_one_hall_are_too_little(walked_down):
    loops = [loop(walked_down, i) for i in range(N)]
    assert (
        admit(ComponentJoiningGate(ComponentJoiningParams(), Compare()), loops, walked_down) == []
    )
    easy = ComponentJoiningGate(ComponentJoiningParams(min_position_spread_m=0.95), Compare())
    assert admit(easy, loops[:8], walked_down) == [(i, i) for i in range(6)]


def test_no_component_may_violate_the_free_space_of_the_other(looked_about):
    """The loops are of the last views; what the first ones saw is in the way."""
    blocked = Compare(lambda query_id: 0.6 if query_id < N + 6 else 0.02)
    loops = [loop(looked_about, i) for i in (6, 8, 10, 11)]
    assert (
        admit(
            ComponentJoiningGate(ComponentJoiningParams(), blocked),
            loops,
            looked_about,
        )
        == []
    )
    assert blocked.asked == set(range(N, 2 * N))
    assert (
        len(admit(ComponentJoiningGate(ComponentJoiningParams(), Compare()), loops, looked_about))
        == 4
    )
    assert (
        len(admit(ComponentJoiningGate(ComponentJoiningParams()), loops, looked_about)) == 4
    )  # by bags: not asked


def test_the_number_of_compared_views_is_limited(looked_about):
    few = Compare()
    loops = [loop(looked_about, i) for i in (0, 3, 6, 9)]
    assert (
        len(
            admit(
                ComponentJoiningGate(ComponentJoiningParams(n_pairs=3), few),
                loops,
                looked_about,
            )
        )
        == 4
    )
    assert 1 <= len(few.asked) <= 3


def test_loops_to_a_third_component_do_not_count(looked_about):
    components = PARTS.copy()
    components[N + 6 :] = 2
    gate = ComponentJoiningGate(
        ComponentJoiningParams(n_required=3, min_view_spread_rad=0.0), Compare()
    )
    assert (
        admit(gate, [loop(looked_about, i) for i in (1, 3, 8, 10)], looked_about, components) == []
    )
    assert len(admit(gate, [loop(looked_about, 11)], looked_about, components)) == 3


def test_loops_from_the_older_component_count_too(looked_about):
    """A place of the younger part seen again once the camera is back in the older one."""
    poses = np.concatenate([looked_about, looked_about[:N]])
    components = np.repeat([0, 1, 0], N)
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    there = [loop(looked_about, i) for i in (0, 3)]
    back = [
        Loop(2 * N + i, N + i, np.eye(4), np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW)
        for i in (6, 9)
    ]
    assert admit(gate, [*there, back[0]], poses, components) == []
    assert admit(gate, back[1:], poses, components) == [
        (0, 0),
        (3, 3),
        (N + 6, N + 6),
        (N + 9, N + 9),
    ]


def test_all_loops_of_one_keyframe_count_once(looked_about):
    poses = np.concatenate([looked_about, looked_about[:1]])
    components = np.array([0] * N + [1] * N + [0])
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    inlier_ratio = [
        Loop(
            2 * N,
            N + i,
            se3.inverse(looked_about[i]) @ poses[-1],
            np.eye(6),
            EdgeKind.LOOP,
            CandidateSource.VIEW,
        )
        for i in range(N)
    ]
    assert gate.admit(inlier_ratio, poses, components) == []


def test_one_keyframe_may_join_three_components_at_once(looked_about):
    """Loops of one keyframe to two other components are all admitted, whatever their order."""
    poses = np.concatenate([looked_about, turned(-2.0, -9.0) @ looked_about[:N]])
    components = np.repeat([0, 1, 2], N)
    kind = np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW
    to_second = [Loop(2 * N + i, N + i, np.eye(4), *kind) for i in (0, 4, 8, 11)]
    to_first = [Loop(2 * N + i, i, np.eye(4), *kind) for i in (0, 4, 8, 11)]
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    for second, first in zip(to_second[:3], to_first[:3], strict=True):
        assert gate.admit([second, first], poses, components) == []
    admitted = gate.admit([to_second[3], to_first[3]], poses, components)
    assert set(map(id, admitted)) == set(map(id, to_second + to_first))


def test_all_loops_of_the_keyframe_that_joins_are_admitted(looked_about):
    gate = ComponentJoiningGate(ComponentJoiningParams(), Compare())
    assert admit(gate, [loop(looked_about, i) for i in (0, 3, 6)], looked_about) == []
    last = loop(looked_about, 9)
    beside = Loop(
        N + 9,
        8,
        se3.inverse(looked_about[8]) @ looked_about[9],
        np.eye(6),
        EdgeKind.LOOP,
        CandidateSource.VIEW,
    )
    admitted = gate.admit([last, beside], looked_about, PARTS)
    assert [(found.query_id - N, found.match_id) for found in admitted[-2:]] == [(9, 9), (9, 8)]
