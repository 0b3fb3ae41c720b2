from dataclasses import replace

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.loops.pairwise_consistency import ConsistencyGate, ConsistencyParams, circuit_errors
from slam_bof.types import CandidateSource, EdgeKind, Loop


@pytest.fixture
def there_and_again():
    """Ten keyframes along a line, then the same ten places again, in another frame."""
    line = np.array([se3.pose(np.eye(3), [0.2 * i, 0.0, 0.0]) for i in range(10)])
    T_map_drifted = se3.exp(np.array([0.0, 0.1, 0.05, 0.3, 0.1, 0.0]))
    return np.concatenate([line, T_map_drifted @ line])


def loop(query_id, match_id, wrong=None):
    """A loop of the fixture: keyframe 10 + i stands where keyframe i stood."""
    T = se3.pose(np.eye(3), [0.2 * (query_id - 10 - match_id), 0.0, 0.0])
    return Loop(
        query_id,
        match_id,
        T if wrong is None else T @ wrong,
        np.eye(6),
        EdgeKind.LOOP,
        CandidateSource.BAG,
    )


def admit(gate, loops, T_map_camera, components=None):
    whole = np.zeros(len(T_map_camera), int)
    return gate.admit(loops, T_map_camera, whole if components is None else components)


def pairs(loops):
    return [(found.query_id, found.match_id) for found in loops]


def test_true_loops_close_the_circuit_whatever_the_drift(there_and_again):
    others = [loop(15, 4), loop(11, 1), loop(19, 2)]
    errors = circuit_errors(loop(12, 2), others, there_and_again)
    np.testing.assert_allclose(errors, [np.eye(4)] * 3, atol=1e-12)
    assert circuit_errors(loop(12, 2), [], there_and_again).shape == (0, 4, 4)


def test_a_wrong_loop_leaves_its_error_over(there_and_again):
    wrong = se3.exp(np.array([0.0, 0.2, 0.0, 0.0, 0.3, 0.0]))
    (error,) = circuit_errors(loop(12, 2, wrong), [loop(15, 4)], there_and_again)
    assert np.linalg.norm(error[:3, 3]) > 0.2
    assert se3.rotation_angle(error) == pytest.approx(0.2)


def test_a_loop_waits_for_a_second_one_that_agrees(there_and_again):
    gate = ConsistencyGate(ConsistencyParams())
    assert admit(gate, [loop(11, 1)], there_and_again[:12]) == []
    assert pairs(admit(gate, [loop(12, 3)], there_and_again[:13])) == [(11, 1), (12, 3)]
    assert pairs(admit(gate, [loop(13, 3)], there_and_again[:14])) == [(13, 3)]


def test_loops_of_the_same_keyframe_do_not_support_each_other(there_and_again):
    gate = ConsistencyGate(ConsistencyParams())
    assert admit(gate, [loop(11, 1), loop(11, 2)], there_and_again[:12]) == []


@pytest.mark.parametrize(
    "wrong",
    [
        se3.pose(np.eye(3), [0.5, 0.0, 0.0]),
        se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0])),
    ],
    ids=["shifted", "turned"],
)
def test_a_wrong_loop_is_never_admitted_and_harms_no_true_one(there_and_again, wrong):
    gate = ConsistencyGate(ConsistencyParams())
    admitted = []
    for i in range(1, 6):
        loops = [loop(10 + i, i)] + ([loop(13, 6, wrong)] if i == 3 else [])
        admitted += admit(gate, loops, there_and_again[: 11 + i])
    assert sorted(pairs(admitted)) == [(10 + i, i) for i in range(1, 6)]


def test_loops_outside_the_window_do_not_count(there_and_again):
    gate = ConsistencyGate(ConsistencyParams(window=3))
    admit(gate, [loop(11, 1)], there_and_again[:12])
    assert admit(gate, [loop(15, 5)], there_and_again[:16]) == []


def test_the_required_number_of_supporters_can_be_set(there_and_again):
    strict = ConsistencyGate(ConsistencyParams(n_required=2))
    assert admit(strict, [loop(11, 1)], there_and_again[:12]) == []
    assert admit(strict, [loop(12, 2)], there_and_again[:13]) == []
    third = admit(strict, [loop(13, 3)], there_and_again[:14])
    assert sorted(pairs(third)) == [(11, 1), (12, 2), (13, 3)]
    off = ConsistencyGate(ConsistencyParams(n_required=0))
    assert pairs(admit(off, [loop(11, 1)], there_and_again[:12])) == [(11, 1)]


def test_loops_inside_different_components_do_not_support_each_other(there_and_again):
    """The poses of two components may by chance make two wrong loops agree."""
    components = np.repeat([0, 1], [10, len(there_and_again) - 10])
    inside_first, inside_second = loop(9, 1), loop(19, 12)
    T = there_and_again
    inside_first = replace(inside_first, T_match_query=se3.inverse(T[1]) @ T[9])
    inside_second = replace(inside_second, T_match_query=se3.inverse(T[12]) @ T[19])
    gate = ConsistencyGate(ConsistencyParams(window=20))
    assert admit(gate, [inside_first], T[:10]) == []
    assert admit(gate, [inside_second], T, components) == []
    gate = ConsistencyGate(ConsistencyParams(window=20))
    assert admit(gate, [inside_first], T[:10]) == []
    assert pairs(admit(gate, [inside_second], T)) == [(9, 1), (19, 12)]
