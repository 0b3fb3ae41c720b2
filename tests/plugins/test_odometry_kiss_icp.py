import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.synthetic import KINECT, spin
from slam_bof.types import DepthFrame
from slam_bof_plugins.odometry_kiss_icp import KissIcpOdometry

SIZE = (KINECT.height, KINECT.width)


@pytest.fixture(scope="module")
def turn(look, standpoint):
    """A quick hand-held turn of 90 degrees at 90 degrees a second, and its true poses."""
    poses = spin(*standpoint, rate_deg_s=90.0, angle_deg=90.0)
    return [look(T, i) for i, T in enumerate(poses)], se3.inverse(poses[0]) @ poses


def track(frames, odometry=None):
    odometry = odometry or KissIcpOdometry()
    return np.array([odometry.process(frame) for frame in frames])


def test_the_preset_holds_under_a_quick_turn(turn):
    frames, truth = turn
    error = se3.inverse(truth) @ track(frames)
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.25
    assert np.degrees(se3.rotation_angle(error)).max() < 6.0


@pytest.mark.parametrize("missing", [0, 65535])
def test_blind_frames_repeat_the_last_pose_and_the_track_goes_on(turn, missing):
    frames, truth = turn
    blind = DepthFrame(0.0, np.full(SIZE, missing, np.uint16), KINECT)
    poses = track([blind, *frames[:10], blind, blind, *frames[10:15]])
    np.testing.assert_array_equal(poses[:2], [np.eye(4)] * 2)
    np.testing.assert_array_equal(poses[11:13], [poses[10]] * 2)
    error = se3.inverse(truth[14]) @ poses[-1]
    assert np.linalg.norm(error[:3, 3]) < 0.10
