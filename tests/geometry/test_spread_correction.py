import numpy as np
import pytest

from slam_bof.geometry import se3, spread_correction


def walk(n_frames):
    """Poses of a camera that walks 1 cm a frame and turns half a degree."""
    motion = se3.exp(np.array([0.0, np.radians(0.5), 0.0, 0.0, 0.0, 0.01]))
    poses = [np.eye(4)]
    for _ in range(n_frames - 1):
        poses.append(poses[-1] @ motion)
    return np.array(poses)


@pytest.fixture
def odometry():
    return walk(21), np.arange(21) / 30.0


def test_no_correction_leaves_every_frame_where_it_was(odometry):
    T_odom_camera, stamps_s = odometry
    keyframes = np.array([0, 10, 20])
    spread = spread_correction(T_odom_camera, stamps_s, keyframes, T_odom_camera[keyframes])
    np.testing.assert_allclose(spread, T_odom_camera, atol=1e-12)


def test_keyframes_get_their_optimised_poses_exactly(odometry):
    T_odom_camera, stamps_s = odometry
    keyframes = np.array([0, 7, 15])
    rng = np.random.default_rng(0)
    T_map_keyframes = T_odom_camera[keyframes] @ se3.exp(0.05 * rng.standard_normal((3, 6)))
    spread = spread_correction(T_odom_camera, stamps_s, keyframes, T_map_keyframes)
    np.testing.assert_allclose(spread[keyframes], T_map_keyframes, atol=1e-12)


def test_frames_after_the_last_keyframe_follow_it_by_odometry(odometry):
    T_odom_camera, stamps_s = odometry
    T_map_odom = se3.exp(np.array([0.0, 0.1, 0.0, 0.2, 0.0, 0.0]))
    T_map_keyframes = np.array([np.eye(4), T_map_odom @ T_odom_camera[10]])
    spread = spread_correction(T_odom_camera, stamps_s, np.array([0, 10]), T_map_keyframes)
    np.testing.assert_allclose(spread[10:], T_map_odom @ T_odom_camera[10:], atol=1e-12)


def test_correction_grows_evenly_and_has_no_lever_arm():
    """Far from the odometry's origin, a turned correction must not fling frames about."""
    T_world_odom = se3.pose(np.eye(3), [100.0, 0.0, 0.0])
    T_odom_camera, stamps_s = T_world_odom @ walk(11), np.arange(11) / 30.0
    shifted = T_odom_camera[10] @ se3.exp(np.array([0.0, 0.05, 0.0, 0.1, 0.0, 0.0]))
    T_map_keyframes = np.array([T_odom_camera[0], shifted])
    spread = spread_correction(T_odom_camera, stamps_s, np.array([0, 10]), T_map_keyframes)
    moved_m = np.linalg.norm(spread[:, :3, 3] - T_odom_camera[:, :3, 3], axis=1)
    assert (np.diff(moved_m) > 0).all()
    assert moved_m.max() == pytest.approx(moved_m[-1])
    assert np.diff(moved_m).max() < 0.02


def test_across_a_loss_frames_go_with_the_keyframe_on_their_side(odometry):
    """Frames 0 to 5 are of one track, 9 to 20 of another, and nothing is known of 6 to 8."""
    T_odom_camera, stamps_s = odometry
    segments = np.repeat([0, -1, 1], [6, 3, 12])
    T_map_odom = se3.pose(np.eye(3), [5.0, 0.0, 0.0])
    keyframes = np.array([0, 10, 20])
    T_map_keyframes = T_odom_camera[keyframes]
    T_map_keyframes[1:] = T_map_odom @ T_map_keyframes[1:]
    spread = spread_correction(T_odom_camera, stamps_s, keyframes, T_map_keyframes, segments)
    np.testing.assert_allclose(spread[:6], T_odom_camera[:6], atol=1e-12)
    np.testing.assert_allclose(spread[9:], T_map_odom @ T_odom_camera[9:], atol=1e-12)
    between_m = spread[6:9, 0, 3] - T_odom_camera[6:9, 0, 3]
    np.testing.assert_allclose(between_m, [3.0, 3.5, 4.0], atol=1e-6)
