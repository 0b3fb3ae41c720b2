import numpy as np
import pytest

from slam_bof.geometry import DepthView, se3
from slam_bof.geometry.projection import (
    by_axis,
    interpolated_depth,
    nearest_pixel,
    project,
)
from slam_bof.geometry.view_stack import ViewStack
from slam_bof.types import Intrinsics

CAMERA = Intrinsics(8, 6, 7.0, 7.0, 3.6, 2.4)


def arrays_of(depth, camera=CAMERA):
    views = ViewStack(30)
    views.add(DepthView(depth, np.zeros((*depth.shape, 3), np.float32), camera))
    return views.arrays()


@pytest.fixture
def wall():
    """A wall square to the view, 2 m away; the last column is unknown."""
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[:, -1] = 0.0
    return arrays_of(depth)


def projected(views, T, points):
    """Columns, rows and depths (3, m) of points (m, 3)."""
    found = np.empty((3, len(points)))
    project(views, T, by_axis(np.asarray(points)), found)
    return found


def depth_at(views, point):
    """Depth that the only view has where a point falls."""
    ((column,), (row,), _) = projected(views, np.eye(4), [point])
    return interpolated_depth(views.depths_m[0], views.width, views.height, column, row)


def test_the_point_of_a_pixel_falls_on_it(wall):
    columns, rows, depths_m = projected(wall, np.eye(4), 2.0 * wall.rays)
    for pixel, (column, row) in enumerate(zip(columns, rows, strict=True)):
        assert nearest_pixel(wall.width, column, row) == pixel
        assert [column, row] == pytest.approx(divmod(pixel, CAMERA.width)[::-1], abs=1e-5)
    assert (depths_m == 2.0).all()


def test_between_pixels_the_nearest_counts(wall):
    x, y = (5.3 - CAMERA.cx) / CAMERA.fx, (1.8 - CAMERA.cy) / CAMERA.fy
    ((column,), (row,), (depth_m,)) = projected(wall, np.eye(4), [(3.0 * x, 3.0 * y, 3.0)])
    assert [column, row, depth_m] == pytest.approx([5.3, 1.8, 3.0])
    assert divmod(nearest_pixel(wall.width, column, row), CAMERA.width) == (2, 5)


@pytest.mark.parametrize(
    "tangent", [[0, np.pi, 0, 0, 0, 0], [0, 0, 0, 9, 0, 0], [0, 0, 0, 0, -9, 0]]
)
def test_what_is_behind_or_aside_falls_nowhere(wall, tangent):
    T = se3.exp(np.array(tangent, np.float64))
    assert (projected(wall, T, 2.0 * wall.rays)[2] == 0.0).all()


@pytest.mark.parametrize(
    ("column", "is_inside"), [(-0.6, False), (-0.4, True), (7.4, True), (7.6, False)]
)
def test_a_pixel_is_a_square(wall, column, is_inside):
    point = ((column - CAMERA.cx) / CAMERA.fx, 0.0, 1.0)
    assert projected(wall, np.eye(4), [point])[2, 0] == (1.0 if is_inside else 0.0)


def test_depth_between_pixels_is_that_of_a_wall_at_a_grazing_angle():
    camera = Intrinsics(40, 6, 70.0, 70.0, 10.0, 2.4)
    column = np.arange(camera.width) - camera.cx
    depth = np.zeros((camera.height, camera.width), np.float32)
    depth[:, column > 0] = camera.fx / column[column > 0]  # 1 m to the right, along the view
    views = arrays_of(depth, camera)
    farthest_off_m = 0.0
    for z in np.linspace(2.6, 20.0, 40):
        assert depth_at(views, (1.0, 0.0, z)) == pytest.approx(z, rel=1e-4)
        ((column,), (row,), _) = projected(views, np.eye(4), [(1.0, 0.0, z)])
        nearest_m = views.depths_m[0, nearest_pixel(views.width, column, row)]
        farthest_off_m = max(farthest_off_m, abs(nearest_m - z))
    assert farthest_off_m > 1.0


@pytest.mark.parametrize("share", [0.0, 0.4])
def test_depth_at_an_edge_is_that_of_the_nearest_pixel_s_surface(wall, share):
    x = (6 + share - CAMERA.cx) / CAMERA.fx * 2.0
    assert depth_at(wall, (x, 0.0, 2.0)) == pytest.approx(2.0)


@pytest.mark.parametrize(("column", "expected_m"), [(2, 2.0), (3, 0.0)])
def test_a_pixel_on_no_surface_has_no_depth(column, expected_m):
    depth = np.full((CAMERA.height, CAMERA.width), 2.0, np.float32)
    depth[2, 3] = 1.0
    point = (column - CAMERA.cx) / CAMERA.fx, (2 - CAMERA.cy) / CAMERA.fy, 1.0
    assert depth_at(arrays_of(depth), point) == pytest.approx(expected_m)


def test_the_border_of_an_image_does_not_continue_on_the_other_side():
    """A slope whose first pixel would be on one surface with the last one of the row above."""
    depth = np.tile(np.linspace(2.0, 2.2, CAMERA.width, dtype=np.float32), (CAMERA.height, 1))
    views = arrays_of(depth)
    x, y = (-0.4 - CAMERA.cx) / CAMERA.fx, (2 - CAMERA.cy) / CAMERA.fy
    inverse = 1.0 / depth[2, :2].astype(np.float64)
    expected_m = 1.0 / (inverse[0] + 0.4 * (inverse[0] - inverse[1]))
    assert depth_at(views, (x, y, 1.0)) == pytest.approx(expected_m, rel=1e-5)


def test_compiled_code_does_what_python_does(wall):
    T = se3.exp(np.array([0.1, -0.05, 0.02, 0.1, 0.0, -0.1]))
    points = by_axis(np.random.default_rng(0).uniform((-2, -2, -1), (2, 2, 4), (50, 3)))
    compiled, interpreted = np.empty((2, *points.shape))
    project(wall, T, points, compiled)
    project.py_func(wall, T, points, interpreted)
    np.testing.assert_array_equal(compiled, interpreted)
    assert 0 < np.count_nonzero(compiled[2]) < 50
