import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.synthetic import camera_poses, darkened, drifted, in_pieces, uncut, without

STAMPS = np.arange(300) / 30.0
UP = np.array([0.0, 0.0, 1.0])


def test_a_cut_keeps_the_times_of_what_is_left():
    play = without(STAMPS, 100, 169)
    assert len(play) == 230
    assert play.restarts == (100,)
    np.testing.assert_array_equal(play.stamps_s, STAMPS[play.indices])
    assert not np.isin(np.arange(100, 170), play.indices).any()


@pytest.mark.parametrize("frames", [(0, 10), (10, 299), (20, 10)])
def test_a_cut_leaves_something_on_both_sides(frames):
    with pytest.raises(ValueError, match="must be within 1 and 298"):
        without(STAMPS, *frames)


def test_pieces_come_in_another_order_with_growing_stamps():
    play = in_pieces(STAMPS, (1, 2, 0))
    assert sorted(play.indices) == list(range(300))
    assert play.indices[[0, 100, 200]].tolist() == [100, 200, 0]
    assert play.restarts == (100, 200)
    gaps = np.diff(play.stamps_s)
    np.testing.assert_allclose(gaps[[99, 199]], 1.0)
    np.testing.assert_allclose(np.delete(gaps, [99, 199]), 1 / 30)


@pytest.mark.parametrize("order", [(), (0, 0), (1, 2)])
def test_an_order_names_every_piece_once(order):
    with pytest.raises(ValueError, match="each piece of 300 frames once"):
        in_pieces(STAMPS, order)


def test_darkness_lasts_as_long_as_asked():
    play = darkened(uncut(STAMPS))
    assert play.dark.sum() == 60
    assert np.flatnonzero(np.diff(play.dark.astype(int)) == 1).tolist() == [99, 199]
    assert play.restarts == ()


def test_drift_is_so_much_a_metre():
    x = np.linspace(0.0, 10.0, 301)
    position = np.stack([x, np.zeros_like(x), np.ones_like(x)], axis=1)
    poses = camera_poses(position, 0.7 * np.sin(x), 0.3)
    odometry = drifted(poses, axis=UP)
    np.testing.assert_array_equal(odometry[0], np.eye(4))
    length = np.linalg.norm(np.diff(odometry[:, :3, 3], axis=0), axis=1).sum()
    assert length == pytest.approx(10.2, abs=1e-6)
    # About the vertical alone: what is level by the true poses stays level.
    in_world = poses[0] @ odometry
    np.testing.assert_allclose(in_world[:, 2, :3], poses[:, 2, :3], atol=1e-9)
    error = in_world[-1, :3, :3] @ poses[-1, :3, :3].T
    assert np.degrees(se3.rotation_angle(error)) == pytest.approx(10.0, abs=1e-6)


def test_without_drift_the_poses_stay():
    poses = camera_poses(np.random.default_rng(0).normal(size=(20, 3)), np.arange(20.0), 0.2)
    odometry = drifted(poses, scale=0.0, rad_per_m=0.0, axis=UP)
    np.testing.assert_allclose(poses[0] @ odometry, poses, atol=1e-9)
