import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.places.pose_hypotheses import PoseHypothesis, are_near, group_hypotheses, mean_pose
from slam_bof.types import Verification


def hypothesis(keyframe_id, tangent, information=None):
    information = np.eye(6) if information is None else information
    T = se3.exp(np.array(tangent, dtype=float))
    return PoseHypothesis(keyframe_id, T, Verification(True, "", T, 0.9, 0.01, information))


def along_x(x):
    return [0.0, 0.0, 0.0, x, 0.0, 0.0]


def test_witnesses_of_one_place_stand_together():
    said = [hypothesis(k, along_x(x)) for k, x in enumerate((0.0, 3.0, 0.1, 3.05))]
    places = group_hypotheses(said, 0.15, 0.1)
    assert [[w.keyframe_id for w in place] for place in places] == [[0, 2], [1, 3]]


def test_a_turn_alone_is_another_place():
    T = se3.exp(np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0]))
    assert not are_near(np.eye(4), T, 0.15, 0.1)
    assert are_near(np.eye(4), T, 0.15, 0.3)


def test_who_knows_more_counts_more():
    said = [hypothesis(0, along_x(0.0), 3.0 * np.eye(6)), hypothesis(1, along_x(0.4))]
    np.testing.assert_allclose(mean_pose(np.eye(4), said), se3.exp(np.array(along_x(0.1))))


def test_each_direction_has_its_own_weight():
    """One knows only x, the other all but x: each is believed in what it knows."""
    knows_x = np.diag([1e-9, 1e-9, 1e-9, 1.0, 1e-9, 1e-9])
    said = [
        hypothesis(0, [0.0, 0.0, 0.0, 0.1, 0.5, 0.5], knows_x),
        hypothesis(1, [0.0, 0.0, 0.0, 0.5, 0.2, 0.0], np.eye(6) - knows_x),
    ]
    assert mean_pose(np.eye(4), said)[:3, 3] == pytest.approx([0.1, 0.2, 0.0], abs=1e-6)


def test_the_mean_of_none_is_the_pose_itself():
    T = se3.exp(np.array(along_x(0.3)))
    np.testing.assert_array_equal(mean_pose(T, []), T)
