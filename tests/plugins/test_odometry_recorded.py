"""Playing back the poses of somebody else's system."""

import numpy as np
import pytest
from conftest import CAMERA

from slam_bof.core import registry
from slam_bof.errors import ConfigError, DatasetError
from slam_bof.geometry import se3, write_kitti, write_tum
from slam_bof.types import DepthFrame, Trajectory

DEPTH = np.full((CAMERA.height, CAMERA.width), 1000, np.uint16)
STAMPS_S = 100.0 + 0.1 * np.arange(10)
STEP = se3.exp(np.array([0.02, 0.1, -0.03, 0.05, 0.01, 0.1]))
TRUTH = np.array([np.linalg.matrix_power(STEP, k) for k in range(10)])
"""T_first_camera."""
START = se3.exp(np.array([1.0, -0.5, 0.3, 4.0, 5.0, 6.0]))


def play(file, stamps_s=STAMPS_S, **options):
    odometry = registry.build("odometry", "recorded", {"file": file, **options})
    return np.array([odometry.process(DepthFrame(float(s), DEPTH, CAMERA)) for s in stamps_s])


@pytest.fixture
def tum(tmp_path):
    write_tum(tmp_path / "poses.txt", Trajectory(STAMPS_S, START @ TRUTH))
    return tmp_path / "poses.txt"


def test_it_starts_at_the_identity_wherever_the_recording_does(tum):
    np.testing.assert_allclose(play(tum), TRUTH, atol=1e-12)


def test_it_stays_in_the_recorded_world_where_that_is_wished(tum):
    stamps_s = np.insert(STAMPS_S, 0, STAMPS_S[0] - 1.0)  # the first frame has no pose yet
    found = play(tum, stamps_s, relative=False)
    np.testing.assert_allclose(found, START @ TRUTH[[0, *range(10)]], atol=1e-12)


def test_poses_between_are_interpolated(tum):
    """Twist and speed are constant here, so that the geodesic is the truth."""
    halfway = play(tum, np.insert(STAMPS_S, 4, 0.5 * (STAMPS_S[3] + STAMPS_S[4])))[4]
    half = se3.exp(3.5 * se3.log(STEP))
    np.testing.assert_allclose(halfway, half, atol=1e-9)


# What moves: its axes in the camera's, column by column.
AXES = {
    "camera": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "ros": [[0, -1, 0], [0, 0, -1], [1, 0, 0]],
    "opengl": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
}


@pytest.mark.parametrize("convention", AXES)
@pytest.mark.parametrize("inverse", [False, True])
def test_axis_conventions(tmp_path, convention, inverse):
    T_camera_body = se3.pose(AXES[convention], np.zeros(3))
    poses = START @ TRUTH @ T_camera_body
    file = tmp_path / "poses.txt"
    write_tum(file, Trajectory(STAMPS_S, se3.inverse(poses) if inverse else poses))
    found = play(file, convention=convention, world_to_camera=inverse)
    np.testing.assert_allclose(found, TRUTH, atol=1e-9)


def test_a_step_ahead_is_along_x_in_ros_axes(tmp_path):
    ahead = np.tile(np.eye(4), (2, 1, 1))
    ahead[1, 0, 3] = 0.5
    write_tum(tmp_path / "poses.txt", Trajectory(STAMPS_S[:2], ahead))
    found = play(tmp_path / "poses.txt", STAMPS_S[:2], convention="ros")[1]
    np.testing.assert_allclose(found[:3, 3], [0.0, 0.0, 0.5], atol=1e-12)


@pytest.mark.parametrize("form", ["kitti", "(N, 4, 4)", "(N, 12)", "(N, 8)"])
def test_other_formats(tmp_path, tum, form):
    file = tmp_path / ("poses.npy" if form != "kitti" else "kitti.txt")
    poses = START @ TRUTH
    if form == "kitti":
        write_kitti(file, Trajectory(STAMPS_S, poses))
    else:
        table = {"(N, 4, 4)": poses, "(N, 12)": poses[:, :3].reshape(-1, 12)}
        np.save(file, table.get(form, np.loadtxt(tum)))
    stamps_s = STAMPS_S if form == "(N, 8)" else STAMPS_S + 7e5  # without stamps: by number
    np.testing.assert_allclose(play(file, stamps_s), TRUTH, atol=1e-9)


def test_gaps_and_ends_hold_the_pose_and_say_so(tmp_path, caplog):
    known = np.r_[2:5, 8:10]
    write_tum(tmp_path / "poses.txt", Trajectory(STAMPS_S[known], TRUTH[known]))
    found = play(tmp_path / "poses.txt", np.append(STAMPS_S, STAMPS_S[-1] + 5.0))
    wanted = se3.inverse(TRUTH[2]) @ TRUTH[[2, 2, 2, 3, 4, 4, 4, 4, 8, 9, 9]]
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    assert [record.getMessage().split(" s: ")[1] for record in caplog.records] == [
        "recorded poses end",
        "recorded poses go on",
        "recorded poses end",
        "recorded poses go on",
        "recorded poses end",
    ]


def test_clocks_that_differ_are_corrected_by_the_offset(tum):
    with pytest.raises(DatasetError, match=r"poses from 100\.000 to 100\.900 s, .*offset_s"):
        play(tum, STAMPS_S + 1e4)
    np.testing.assert_allclose(play(tum, STAMPS_S + 1e4, offset_s=1e4), TRUTH, atol=1e-6)


def test_no_file_is_told_of_before_the_run(tmp_path):
    with pytest.raises(DatasetError, match=r"none\.txt: cannot be read"):
        play(tmp_path / "none.txt")
    with pytest.raises(DatasetError, match=r"none\.npy: cannot be read"):
        play(tmp_path / "none.npy")
    with pytest.raises(ConfigError, match="'file'"):
        registry.build("odometry", "recorded")


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 5)), r"found an array \(4, 5\) of float64"),
        (np.zeros((3, 4, 4)), "pose 0: found a matrix that is no rotation"),
        (np.full((3, 4, 4), np.nan), "found no pose"),
        (np.zeros((0, 4, 4)), "found no pose"),
        (np.zeros((2, 8)), "strictly increasing timestamps"),
        (np.array([["a"] * 8]), "found an array"),
    ],
)
def test_arrays_that_are_no_poses(tmp_path, array, message):
    np.save(tmp_path / "poses.npy", array)
    with pytest.raises(DatasetError, match=message) as caught:
        play(tmp_path / "poses.npy")
    assert "\n" not in str(caught.value)


def test_text_that_is_no_trajectory(tmp_path):
    (tmp_path / "poses.txt").write_text("hello world\n")
    with pytest.raises(DatasetError, match=r"poses\.txt, line 1"):
        play(tmp_path / "poses.txt")


def test_an_array_with_a_pose_far_away_is_refused(tmp_path):
    rows = np.hstack([STAMPS_S[:, None], TRUTH[:, :3, 3], se3.to_quaternion(TRUTH)])
    np.save(tmp_path / "rows.npy", rows)
    np.testing.assert_allclose(play(tmp_path / "rows.npy"), TRUTH, atol=1e-12)
    rows[3, 2] = 1e38
    np.save(tmp_path / "rows.npy", rows)
    with pytest.raises(DatasetError, match=r"rows.npy: found a position at 1e\+38 m"):
        play(tmp_path / "rows.npy")
