import numpy as np
import pytest

from slam_bof.geometry import DepthView
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


def test_points_of_a_surface_have_its_normal(views):
    points, normals = views.surface(0)
    assert (points[:, 2] == 2.0).all()
    np.testing.assert_allclose(normals, np.tile([0.0, 0.0, -1.0], (30, 1)))


def test_points_of_several_views_are_those_of_each(views):
    together = views.sampled(np.array([1, 0]))
    for points, view_id in zip(together, (1, 0), strict=True):
        np.testing.assert_array_equal(points, views.sampled(view_id))


def test_samples_are_of_known_pixels_and_the_first_of_them_the_same(views):
    points = views.sampled(0)
    assert points.shape == (30, 3)
    assert (points[:, 2] == 2.0).all()
    assert len(np.unique(points, axis=0)) == 30
    np.testing.assert_array_equal(views.sampled(0, 7), points[:7])
    assert views.nbytes == 2 * (48 * (4 + 3) + 2 * 30 * 4 + 8)


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
    depths_m = views.arrays().depths_m[views.rows(np.array([1, 2]))]
    np.testing.assert_array_equal(depths_m.max(axis=1), [3.0, 4.0])
