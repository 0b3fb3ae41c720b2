from pathlib import Path

import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.geometry import read_kitti, read_tum, se3, write_kitti, write_tum
from slam_bof.types import Trajectory


@pytest.fixture
def trajectory() -> Trajectory:
    rng = np.random.default_rng(0)
    stamps_s = 1305031102.175304 + np.cumsum(rng.uniform(0.02, 0.04, 50))
    return Trajectory(stamps_s, se3.exp(rng.normal(scale=2.0, size=(50, 6))))


def test_tum_round_trips(tmp_path: Path, trajectory: Trajectory) -> None:
    write_tum(tmp_path / "t.txt", trajectory)
    read = read_tum(tmp_path / "t.txt")
    np.testing.assert_array_equal(read.stamps_s, trajectory.stamps_s)
    np.testing.assert_array_equal(read.poses[:, :3, 3], trajectory.poses[:, :3, 3])
    np.testing.assert_allclose(read.poses, trajectory.poses, rtol=0, atol=2e-15)


def test_kitti_round_trips_exactly(tmp_path: Path, trajectory: Trajectory) -> None:
    write_kitti(tmp_path / "k.txt", trajectory)
    read = read_kitti(tmp_path / "k.txt", trajectory.stamps_s)
    np.testing.assert_array_equal(read.poses, trajectory.poses)
    np.testing.assert_array_equal(read.stamps_s, trajectory.stamps_s)
    np.testing.assert_array_equal(read_kitti(tmp_path / "k.txt").stamps_s, np.arange(50.0))


@pytest.mark.parametrize("write", [write_tum, write_kitti])
def test_the_same_trajectory_gives_the_same_bytes(tmp_path, trajectory, write) -> None:
    write(tmp_path / "a.txt", trajectory)
    write(tmp_path / "b.txt", trajectory)
    text = (tmp_path / "a.txt").read_bytes()
    assert text == (tmp_path / "b.txt").read_bytes()
    assert text.count(b"\n") == len(trajectory)
    assert b"\r" not in text


def test_tum_lines_are_stamp_translation_quaternion_xyzw(tmp_path: Path) -> None:
    quarter_turn_about_z = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    poses = se3.pose(quarter_turn_about_z, [1.0, 2.0, 3.0])[None]
    write_tum(tmp_path / "t.txt", Trajectory(np.array([0.1]), poses))
    numbers = [float(number) for number in (tmp_path / "t.txt").read_text().split()]
    np.testing.assert_allclose(numbers, [0.1, 1, 2, 3, 0, 0, 0.5**0.5, 0.5**0.5])


def test_unknown_poses_keep_their_line_only_in_kitti(tmp_path: Path, trajectory) -> None:
    poses = trajectory.poses.copy()
    poses[[0, 7]] = np.nan
    partly = Trajectory(trajectory.stamps_s, poses)
    write_tum(tmp_path / "t.txt", partly)
    write_kitti(tmp_path / "k.txt", partly)
    known = np.setdiff1d(np.arange(50), [0, 7])
    np.testing.assert_array_equal(read_tum(tmp_path / "t.txt").stamps_s, trajectory.stamps_s[known])
    np.testing.assert_array_equal(read_kitti(tmp_path / "k.txt").poses, poses)


def test_empty_trajectories_round_trip(tmp_path: Path) -> None:
    write_tum(tmp_path / "t.txt", Trajectory())
    write_kitti(tmp_path / "k.txt", Trajectory())
    assert len(read_tum(tmp_path / "t.txt")) == 0
    assert read_kitti(tmp_path / "k.txt").poses.shape == (0, 4, 4)


def test_comments_are_skipped_and_few_digits_are_made_orthonormal(tmp_path: Path) -> None:
    file = tmp_path / "groundtruth.txt"
    file.write_text("# timestamp tx ty tz qx qy qz qw\n\n1.5 0 0 1 0.707 0 0 0.707\n")
    read = read_tum(file)
    assert read.stamps_s.tolist() == [1.5]
    R = read.poses[0, :3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-15)


GOOD = "1.0 0 0 0 0 0 0 1\n"
MIRROR = "-1 0 0 0 0 1 0 0 0 0 1 0\n"


@pytest.mark.parametrize(
    ("text", "line", "found"),
    [
        (GOOD + "2.0 0 0 0 0 0 0\n", 2, "found 7 numbers, expected 8"),
        (GOOD + "2.0 0 0 zero 0 0 0 1\n", 2, "found '2.0 0 0 zero 0 0 0 1'"),
        ("# stamps\n2.0 nan 0 0 0 0 0 1\n", 2, "found NaN"),
        ("1.0 0 inf 0 0 0 0 1\n", 1, "found NaN or infinity"),
        ("1.0 0 0 0 0 0 0 1.5\n", 1, "quaternion of norm 1.5, expected 1"),
        ("1.0 0 0 0 0 0 0 0\n", 1, "quaternion of norm 0, expected 1"),
    ],
)
def test_malformed_tum_is_one_line_that_names_the_place(tmp_path, text, line, found) -> None:
    file = tmp_path / "bad.txt"
    file.write_text(text)
    with pytest.raises(DatasetError) as caught:
        read_tum(file)
    message = str(caught.value)
    assert message.startswith(f"{file}, line {line}: ")
    assert found in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("2.0 nan nan nan nan nan nan nan", "line 2: found NaN or infinity"),
        ("2.0 -inf -inf -inf -inf -inf -inf -inf", "line 2: found NaN or infinity"),
        ("2.0 -1.#IND 0 0 0 0 0 1", "line 2: found NaN or infinity"),
        ("2.0 0 0 0 0 0 0 0", "line 2: found a quaternion of norm 0, expected 1"),
    ],
)
def test_a_pose_that_the_recorder_did_not_know_is_unknown(tmp_path, caplog, line, problem) -> None:
    file = tmp_path / "gaps.txt"
    file.write_text(f"{GOOD}{line}\n3.0 0 0 0 0 0 0 1\n")
    read = read_tum(file)
    assert read.stamps_s.tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(read.poses).all(axis=(1, 2)).tolist() == [False, True, False]
    assert f"{file}: 1 of 3 poses are unknown or left out; the first: " in caplog.text
    assert problem in caplog.text


@pytest.mark.parametrize("stamp", ["1.0", "0.5", "nan", "-inf"])
def test_a_line_whose_stamp_does_not_grow_is_left_out(tmp_path, caplog, stamp) -> None:
    file = tmp_path / "twice.txt"
    file.write_text(f"{GOOD}{stamp} 5 0 0 0 0 0 1\n3.0 0 0 0 0 0 0 1\n")
    read = read_tum(file)
    assert read.stamps_s.tolist() == [1.0, 3.0]
    assert read.poses[:, 0, 3].tolist() == [0.0, 0.0]
    assert "line 2: found" in caplog.text


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("1 0 0 0 0 1 0 0 0 0 1\n", "found 11 numbers, expected 12"),
        ("1 0 0 nan 0 1 0 0 0 0 1 0\n", "found NaN"),
        ("2 0 0 0 0 1 0 0 0 0 1 0\n", "no rotation (determinant 2, R'R off by 3)"),
        (MIRROR, "no rotation (determinant -1"),
    ],
)
def test_malformed_kitti_is_one_line_that_names_the_place(tmp_path, text, found) -> None:
    file = tmp_path / "bad.txt"
    file.write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" + text)
    with pytest.raises(DatasetError) as caught:
        read_kitti(file)
    assert str(caught.value).startswith(f"{file}, line 2: ")
    assert found in str(caught.value)


def test_as_many_stamps_as_poses(tmp_path: Path, trajectory: Trajectory) -> None:
    write_kitti(tmp_path / "k.txt", trajectory)
    with pytest.raises(DatasetError, match="found 50 poses, expected 3"):
        read_kitti(tmp_path / "k.txt", np.arange(3.0))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match=r"none\.txt: cannot be read \(No such file"):
        read_tum(tmp_path / "none.txt")
    (tmp_path / "image.txt").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(DatasetError, match="found binary data"):
        read_kitti(tmp_path / "image.txt")
