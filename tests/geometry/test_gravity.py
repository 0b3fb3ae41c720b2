import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slam_bof.geometry import GravityParams, GravityTracker, level_frame, make_view

DOWN = np.array([0.0, 0.0, -1.0])  # in the synthetic world, whose z is up


def poses(standpoint, n=8):
    """A camera that turns in the room, held 20 degrees askew and looking down a little."""
    for yaw in np.linspace(0.0, 1.5, n):
        T = np.eye(4)
        T[:3, 0], T[:3, 1] = [np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1]
        T[:3, 2] = [np.cos(yaw), np.sin(yaw), 0]
        T[:3, :3] = T[:3, :3] @ Rotation.from_euler("xz", [-15, 20], degrees=True).as_matrix()
        T[:3, 3] = [*standpoint, 1.3]
        yield T


def angle_deg(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


def test_gravity_is_found_within_two_degrees(look, standpoint):
    first, *_ = every = list(poses(standpoint))
    tracker = GravityTracker()
    for index, T_world_camera in enumerate(every):
        view = make_view(look(T_world_camera, index))
        normals = view.normals_camera[view.normals_camera.any(axis=-1)]
        T_odom_camera = np.linalg.inv(first) @ T_world_camera
        down = tracker.update(normals, T_odom_camera)
    assert angle_deg(T_world_camera[:3, :3] @ down, DOWN) < 2.0


def test_a_lost_odometry_is_noticed(look, standpoint):
    tracker = GravityTracker()
    for index, T_world_camera in enumerate(poses(standpoint)):
        view = make_view(look(T_world_camera, index))
        normals = view.normals_camera[view.normals_camera.any(axis=-1)]
        rolled = np.eye(4)
        rolled[:3, :3] = Rotation.from_euler(
            "xz", [9 * index, -12 * index], degrees=True
        ).as_matrix()
        down = tracker.update(normals, rolled @ T_world_camera)
        if index > 2:
            assert angle_deg(T_world_camera[:3, :3] @ down, DOWN) < 12.0


def test_normals_beyond_the_gates_do_not_count(look, standpoint):
    T = next(iter(poses(standpoint)))
    normals = make_view(look(T)).known_normals()
    start = T[:3, :3].T @ Rotation.from_euler("x", 15, degrees=True).apply(DOWN)
    narrow = GravityParams(first_gates_deg=(1.0,), lost_margin=1.0)
    assert angle_deg(GravityTracker(start, narrow).update(normals, np.eye(4)), start) < 5.0
    wide = GravityTracker(start).update(normals, np.eye(4))
    assert angle_deg(T[:3, :3] @ wide, DOWN) < 4.0


def test_a_map_whose_poses_are_right_is_not_left_for_one_view(look, standpoint):
    """One view, askew to the others, would say otherwise by itself."""
    T = next(iter(poses(standpoint)))
    down = T[:3, :3].T @ DOWN
    normals = make_view(look(T)).known_normals()
    lost, trusted = GravityTracker(down), GravityTracker(down, never_lost=True)
    for tracker in (lost, trusted):
        for _ in range(6):
            tracker.update(normals, np.eye(4))
    askew = Rotation.from_euler("zx", [20, 25], degrees=True).as_matrix()
    seen = normals @ askew.T
    assert trusted.update(seen, np.eye(4)) @ down > np.cos(np.radians(20))
    assert lost.update(seen, np.eye(4)) @ (askew @ down) > np.cos(np.radians(5))


def test_without_surfaces_the_direction_stays():
    tilt = Rotation.from_euler("x", 10, degrees=True).as_matrix()
    T_odom_camera = np.eye(4)
    T_odom_camera[:3, :3] = tilt
    tracker = GravityTracker((0.0, 2.0, 0.0))
    np.testing.assert_allclose(tracker.update(np.empty((0, 3)), T_odom_camera), tilt.T[:, 1])


def test_a_single_wall_does_not_turn_the_direction_over():
    wall = np.tile([0.0, 0.0, -1.0], (100, 1))  # square to the view, level by any roll
    roll = Rotation.from_euler("z", 10, degrees=True).as_matrix()
    tracker = GravityTracker(roll @ [0.0, 1.0, 0.0])
    down = tracker.update(wall, np.eye(4))
    assert angle_deg(down, roll[:, 1]) < 1e-3


@pytest.mark.parametrize(
    "down", [[0.0, 1.0, 0.0], [0.3, 0.8, 0.5], [0.0, 0.01, 1.0], [0.0, 0.0, -1.0], [0.1, 0.9, -0.4]]
)
def test_the_level_frame_is_a_rotation_with_down_as_y(down):
    down = np.array(down) / np.linalg.norm(down)
    R = level_frame(down)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(R) == pytest.approx(1.0)
    np.testing.assert_allclose(R @ down, [0, 1, 0], atol=1e-12)


def test_the_optical_axis_has_no_sideways_part():
    R = level_frame(np.array([0.2, 0.9, 0.3]))
    x, _, z = R @ [0.0, 0.0, 1.0]
    assert x == pytest.approx(0.0, abs=1e-12)
    assert z > 0
