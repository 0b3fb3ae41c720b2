"""States of an odometry that do not fit the frames that were restored are not used."""

import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.slam.restored_odometry import restore_odometry, state_of
from slam_bof.types import FramePose, OdometryState
from slam_bof_plugins.odometry_kiss_icp import KissIcpOdometry
from slam_bof_plugins.odometry_open3d import Open3dOdometry


class Frames:
    """Five frames of a box room, of which the second cannot be used."""

    sequence = "room/seq-01"

    def __init__(self, frame):
        self._frame = frame

    def __len__(self):
        return 5

    def frame(self, index):
        return self._frame


@pytest.fixture
def saved(box_room_frame):
    """The state after the frames 0, 2 and 3."""
    odometry = KissIcpOdometry()
    for _ in range(3):
        odometry.process(box_room_frame)
    return state_of(odometry, [0, 2])


def restored(frame, n):
    return [FramePose(frame.stamp_s, np.eye(4), np.eye(4), 0)] * n


def test_frames_that_could_not_be_used_are_known(saved):
    assert saved.frame_index == 2
    assert saved.skipped.tolist() == [1]


def test_the_frames_of_a_state_need_not_be_processed_again(saved, box_room_frame):
    frames, odometry = restored(box_room_frame, 4), KissIcpOdometry()
    assert restore_odometry(odometry, saved, Frames(box_room_frame), frames) == [0, 2, 3]
    assert odometry.state()["points_odom"].tobytes() == saved.arrays["points_odom"].tobytes()


@pytest.mark.parametrize(
    ("frame_index", "skipped"), [(10**15, [1]), (3, [1]), (2, [1, 9]), (2, [1, 2, 3])]
)
def test_a_state_of_other_frames_is_not_used(saved, box_room_frame, frame_index, skipped):
    state = OdometryState(frame_index, np.array(skipped, np.int64), saved.arrays)
    frames = restored(box_room_frame, 3)
    assert restore_odometry(KissIcpOdometry(), state, Frames(box_room_frame), frames) == []


def test_an_odometry_without_a_state_runs_again(saved, box_room_frame):
    assert state_of(Open3dOdometry(), []) is None
    frames = restored(box_room_frame, 3)
    assert restore_odometry(Open3dOdometry(), saved, Frames(box_room_frame), frames) == []


def test_another_sequence_is_refused(saved, box_room_frame):
    other = [FramePose(box_room_frame.stamp_s + 1.0, np.eye(4), np.eye(4), 0)] * 3
    with pytest.raises(DatasetError, match="is this the same sequence"):
        restore_odometry(KissIcpOdometry(), saved, Frames(box_room_frame), other)
