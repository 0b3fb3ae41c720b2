import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, camera_poses
from slam_bof.synthetic.meshes import box


@pytest.fixture(scope="module")
def room():
    return Scene3D(box(-2, -1.5, -3, 2, 1.5, 3, (0.8, 0.5, 0.2)), CAMERA)


@pytest.mark.parametrize("seed", range(3))
def test_depth_is_z_as_a_box_room_has_it(room, seed):
    rng = np.random.default_rng(seed)
    T_world_camera = se3.exp(rng.uniform(-1, 1, 6))
    expected = box_room_depth_mm(CAMERA, T_world_camera)
    depth_mm = 1000 * room.view(T_world_camera).depth_m
    assert np.abs(depth_mm - expected).max() < 0.6


def test_cosine_is_one_where_a_wall_is_met_straight_on(room):
    view = room.view(np.eye(4))
    assert view.cosine[60, 80] == pytest.approx(1.0, abs=1e-6)
    ray = np.array([(10 - 80) / CAMERA.fx, (100 - 60) / CAMERA.fy, 1.0])
    assert view.cosine[100, 10] == pytest.approx(1 / np.linalg.norm(ray), abs=1e-5)


def test_rays_that_leave_the_scene_see_nothing():
    view = Scene3D(box(-0.1, -0.1, 2, 0.1, 0.1, 2.2, (1, 1, 1)), CAMERA).view(np.eye(4))
    assert view.depth_m[60, 80] == pytest.approx(2.0)
    assert view.depth_m[0, 0] == 0
    assert view.triangle[0, 0] == -1


def test_colors_are_those_of_the_mesh_and_black_outside():
    scene = Scene3D(box(-0.1, -0.1, 2, 0.1, 0.1, 2.2, (1.0, 0.5, 0.0)), CAMERA)
    color = scene.color(scene.view(np.eye(4)))
    red, green, blue = (int(value) for value in color[60, 80])
    assert red > 150
    assert green == pytest.approx(red / 2, abs=2)
    assert blue == 0
    assert not color[0, 0].any()


def test_dark_surfaces_return_less():
    views = [
        Scene3D(box(-1, -1, 2, 1, 1, 2.2, (a, a, a)), CAMERA).view(np.eye(4)) for a in (0.9, 0.07)
    ]
    assert views[1].returned[60, 80] == pytest.approx(0.2 * views[0].returned[60, 80])


@pytest.mark.parametrize(
    ("yaw", "pitch", "axis", "row"),
    [
        (np.pi / 2, 0.0, 2, (0, 1, 0)),
        (np.pi / 2, 0.0, 0, (1, 0, 0)),
        (0.3, 0.0, 1, (0, 0, -1)),
        (0.0, np.pi / 2, 2, (0, 0, -1)),
    ],
)
def test_camera_axes_follow_yaw_and_pitch(yaw, pitch, axis, row):
    T_world_camera = camera_poses([1.0, 2.0, 3.0], yaw, pitch)
    np.testing.assert_allclose(T_world_camera[:3, axis], row, atol=1e-12)
    np.testing.assert_allclose(T_world_camera[:3, 3], [1, 2, 3])
    assert np.linalg.det(T_world_camera[:3, :3]) == pytest.approx(1.0)


def test_roll_lowers_the_right_side():
    assert camera_poses([0, 0, 0], 0.4, 0.2, 0.1)[2, 0] < 0
