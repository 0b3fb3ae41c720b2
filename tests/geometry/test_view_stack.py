import numpy as np
import pytest

from slam_bof.geometry import DepthView, se3
from slam_bof.geometry.depth_view import surface_normals
from slam_bof.geometry.view_stack import ViewStack
from slam_bof.types import Intrinsics

CAMERA = Intrinsics(8, 6, 7.0, 7.0, 3.6, 2.4)


def wall(depth_m):
    """A wall square to the view; the last column is unknown."""
    depth = np.full((CAMERA.height, CAMERA.width), depth_m, np.float32)
    depth[:, -1] = 0.0
    view = DepthView(depth, np.zeros((*depth.shape, 3), np.float32), CAMERA)
    return DepthView(depth, surface_normals(view.rays() * depth[..., None]), CAMERA)


@pytest.fixture
def views():
    views = ViewStack(30)
    for depth_m in (2.0, 3.0):
        views.add(wall(depth_m))
    return views


def poses(*tangents):
    return se3.exp(np.array(tangents, np.float64)).astype(np.float32)


STAND = [0, 0, 0, 0, 0, 0]


def test_a_view_s_points_fall_on_their_own_pixels(views):
    projected = views.project_points(views.points_camera(0), poses(STAND))
    row, column = np.divmod(np.arange(CAMERA.height * CAMERA.width), CAMERA.width)
    known = column < CAMERA.width - 1
    np.testing.assert_array_equal(projected.column[0], column[known])
    np.testing.assert_array_equal(projected.row[0], row[known])
    assert projected.inside.all()
    np.testing.assert_allclose(projected.depth_m, 2.0)


def test_what_is_behind_or_aside_falls_nowhere_and_sees_nothing(views):
    T = poses(STAND, [0, np.pi, 0, 0, 0, 0], [0, 0, 0, 9, 0, 0])
    projected = views.project_points(views.sampled(0), T)
    assert projected.inside.all(axis=1).tolist() == [True, False, False]
    assert not projected.inside[1:].any()
    depths_m, _ = views.depth_at(np.array([0, 0, 0]), projected)
    np.testing.assert_array_equal(depths_m, np.repeat([[2.0], [0.0], [0.0]], 30, axis=1))


def test_each_view_is_looked_at(views):
    projected = views.project_points(views.sampled(0), poses(STAND, STAND))
    depths_m, _ = views.depth_at(np.array([0, 1]), projected)
    np.testing.assert_array_equal(depths_m, np.repeat([[2.0], [3.0]], 30, axis=1))


def side_wall(camera):
    """A wall 1 m to the right, along the view."""
    column = np.arange(camera.width) - camera.cx
    depth = np.zeros((camera.height, camera.width), np.float32)
    depth[:, column > 0] = camera.fx / column[column > 0]
    return DepthView(depth, np.zeros((*depth.shape, 3), np.float32), camera)


def test_depth_between_pixels_is_that_of_a_wall_at_a_grazing_angle():
    camera = Intrinsics(40, 6, 70.0, 70.0, 10.0, 2.4)
    views = ViewStack(30)
    views.add(side_wall(camera))
    points = np.array([[1.0, 0.0, z] for z in np.linspace(2.6, 20.0, 40)], np.float32)
    projected = views.project_points(points, poses(STAND))
    depths_m, _ = views.interpolated_depth_at(np.array([0]), projected)
    assert depths_m[0] == pytest.approx(points[:, 2], rel=1e-4)
    nearest_m, _ = views.depth_at(np.array([0]), projected)
    assert np.abs(nearest_m[0] - points[:, 2]).max() > 1.0


def test_depth_at_an_edge_is_that_of_the_nearest_pixel_s_surface(views):
    points = np.array([[(6 + share - CAMERA.cx) / CAMERA.fx * 2.0, 0.0, 2.0] for share in (0, 0.4)])
    projected = views.project_points(points.astype(np.float32), poses(STAND))
    depths_m, _ = views.interpolated_depth_at(np.array([0]), projected)
    np.testing.assert_allclose(depths_m, 2.0, rtol=1e-6)


def test_a_pixel_on_no_surface_has_no_depth_between_pixels():
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[2, 3] = 1.0
    views = ViewStack(30)
    views.add(DepthView(depth, np.zeros((*depth.shape, 3), np.float32), CAMERA))
    x = np.array([(column - CAMERA.cx) / CAMERA.fx for column in (2, 3)])
    points = np.stack([x, np.full(2, (2 - CAMERA.cy) / CAMERA.fy), np.ones(2)], axis=1)
    projected = views.project_points(points.astype(np.float32), poses(STAND))
    depths_m, _ = views.interpolated_depth_at(np.array([0]), projected)
    np.testing.assert_allclose(depths_m, [[2.0, 0.0]])


def test_own_points_fall_as_shared_ones_do(views):
    T = poses(STAND, [0.0, 0.1, 0.0, 0.2, 0.0, 0.1])
    shared = views.project_points(views.sampled(1), T)
    own = views.project_points(views.sampled(np.array([1, 1])), T)
    for one, other in zip(shared, own, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_surfaces_are_where_points_fall(views):
    points, normals = views.surface(0)
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, -1.0], (30, 1)))
    there, facing = views.surface_at(np.array([0]), views.project_points(points, poses(STAND)))
    np.testing.assert_allclose(there[0].T, points, atol=1e-6)
    np.testing.assert_allclose(facing[0].T, normals)


def test_samples_are_of_known_pixels_and_the_first_of_them_the_same(views):
    points = views.sampled(0)
    assert points.shape == (30, 3)
    assert (points[:, 2] == 2.0).all()
    assert len(np.unique(points, axis=0)) == 30
    np.testing.assert_array_equal(views.sampled(0, 7), points[:7])
    assert views.nbytes == 2 * 48 * (4 + 3) + 2 * 2 * 30 * 4


def test_the_memory_of_a_dropped_view_is_used_again(views):
    n_bytes = views.nbytes
    views.drop(0)
    assert views.nbytes == n_bytes / 2
    with pytest.raises(KeyError, match="dropped"):
        views.sampled(0)
    with pytest.raises(KeyError, match="no view 0"):
        views.drop(0)
    views.add(wall(4.0))
    assert len(views) == 3
    assert views.nbytes == n_bytes
    for view_id, depth_m in ((1, 3.0), (2, 4.0)):
        assert (views.points_camera(view_id)[:, 2] == depth_m).all()
    both = np.array([1, 2])
    projected = views.project_points(views.sampled(1), poses(STAND, STAND))
    depths_m, _ = views.depth_at(both, projected)
    np.testing.assert_array_equal(depths_m, np.repeat([[3.0], [4.0]], 30, axis=1))
    views.truncate(1)
    assert (len(views), views.nbytes) == (1, 0)
