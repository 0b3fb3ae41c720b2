import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.tracking import KeyframeParams, KeyframeSelector


def select_along(params, poses):
    selector = KeyframeSelector(params)
    return [i for i, T in enumerate(poses) if selector.select(i, T)]


def moved(x_m=0.0, yaw_rad=0.0):
    return se3.exp(np.array([0.0, yaw_rad, 0.0, 0.0, 0.0, 0.0])) @ se3.pose(
        np.eye(3), [x_m, 0.0, 0.0]
    )


def test_first_frame_is_always_a_keyframe():
    assert select_along(KeyframeParams(), [np.eye(4)]) == [0]


@pytest.mark.parametrize(
    ("poses", "expected"),
    [
        ([moved(x_m=0.04 * i) for i in range(8)], [0, 3, 6]),
        ([moved(yaw_rad=0.09 * i) for i in range(8)], [0, 3, 6]),
        ([moved(x_m=0.003 * i) for i in range(8)], [0, 5]),
        ([moved(yaw_rad=0.003 * i) for i in range(8)], [0, 5]),
        ([moved(x_m=0.004 * (i % 2), yaw_rad=0.004 * (i % 3 == 0)) for i in range(50)], [0]),
        ([moved() for _ in range(40)] + [moved(x_m=0.012), moved(x_m=0.012)], [0, 40]),
    ],
    ids=["distance", "angle", "slow", "slow turn", "at rest", "at rest, then slow"],
)
def test_motion_policy_keeps_what_moved_enough(poses, expected):
    params = KeyframeParams(policy="motion", distance_m=0.1, angle_rad=0.25, max_gap=5)
    assert select_along(params, poses) == expected


def test_motion_is_measured_from_the_last_keyframe_not_from_the_last_frame():
    there_and_back = [moved(x_m=x) for x in (0.0, 0.06, 0.0, 0.06, 0.0)]
    assert select_along(KeyframeParams(distance_m=0.1), there_and_back) == [0]


def test_every_policy_keeps_each_kth_frame_whatever_the_motion():
    poses = [moved(x_m=float(i)) for i in range(10)]
    assert select_along(KeyframeParams(policy="every", every=4), poses) == [0, 4, 8]
