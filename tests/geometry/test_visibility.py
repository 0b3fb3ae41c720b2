import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.geometry import make_view, se3
from slam_bof.geometry.view_stack import ViewStack
from slam_bof.geometry.visibility import coverage
from slam_bof.types import DepthFrame

TOLERANCE = (0.05, 0.02)
TURNS = np.radians([0.0, -40.0, 40.0, 0.0])


def turned(yaw):
    return se3.exp(np.array([0.0, yaw, 0.0, 0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def poses():
    return np.array([turned(yaw) for yaw in TURNS])


@pytest.fixture(scope="module")
def views(poses):
    """A view of a box room, one to either side, and one of a smaller room."""
    stack = ViewStack(300)
    for pose in poses[:3]:
        stack.add(make_view(DepthFrame(0.0, box_room_depth_mm(CAMERA, pose), CAMERA)))
    small = box_room_depth_mm(CAMERA, np.eye(4), (1.0, 1.0, 2.0))
    stack.add(make_view(DepthFrame(0.0, small, CAMERA)))
    return stack


def test_what_one_does_not_see_another_may(views, poses):
    def of(*ids):
        return coverage(views, 0, np.array(ids), se3.inverse(poses[list(ids)]), TOLERANCE)

    left, both = of(1), of(1, 2)
    assert left.visible_ratio < 0.6
    assert both.visible_ratio > left.visible_ratio + 0.3
    for found in (left, both):
        assert found.inlier_ratio > 0.98
        assert found.free_space_violation == found.free_space_violation_reverse == 0.0


def test_what_stands_before_is_told_both_ways(views):
    here = np.eye(4)[None]
    nearer = coverage(views, 3, np.array([0]), here, TOLERANCE)
    assert nearer.free_space_violation == pytest.approx(1.0)
    assert (nearer.inlier_ratio, nearer.free_space_violation_reverse) == (0.0, 0.0)
    farther = coverage(views, 0, np.array([3]), here, TOLERANCE)
    assert farther.free_space_violation_reverse == pytest.approx(1.0)
    assert (farther.inlier_ratio, farther.free_space_violation) == (0.0, 0.0)


def test_most_of_those_who_can_tell_decide_what_blocks(views):
    ids = np.array([0, 0, 3])
    found = coverage(views, 3, ids, np.tile(np.eye(4), (3, 1, 1)), TOLERANCE)
    assert found.inlier_ratio == 1.0  # by itself
    assert found.free_space_violation == pytest.approx(1.0)  # before what the two others see


def test_far_away_nothing_is_compared(views):
    away = se3.pose(np.eye(3), [0.0, 0.0, -100.0])[None]
    assert tuple(coverage(views, 0, np.array([1]), away, TOLERANCE)) == (0.0, 0.0, 0.0, 0.0)
