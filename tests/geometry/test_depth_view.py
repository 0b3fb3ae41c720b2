import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.geometry import make_view, quantize_depth, restore_frame, subsample, view_points
from slam_bof.geometry.depth_view import smooth_depth, surface_normals
from slam_bof.types import DepthFrame, Intrinsics, SensorParams


def test_a_view_is_every_eighth_pixel_of_a_vga_image(look, standpoint):
    T = np.eye(4)
    T[:3, :3] = [[0, 0, 1], [-1, 0, 0], [0, -1, 0]]
    T[:3, 3] = [*standpoint, 1.3]
    frame = look(T, 0)
    view, points_camera = make_view(frame), view_points(frame)
    assert (view.intrinsics.width, view.intrinsics.height) == (80, 60)
    known = frame.depth_m(8) > 0
    assert (view.depth_m[known] > 0).all()
    assert np.mean((view.depth_m > 0) & ~known) < 0.02  # filled in
    off = np.abs(view.depth_m[known] / frame.depth_m(8)[known] - 1)
    assert np.median(off) < 0.01  # what noise there is
    assert len(points_camera) == np.count_nonzero(frame.depth_m(4))
    x, y, z = points_camera.T
    camera = frame.intrinsics
    columns, rows = x / z * camera.fx + camera.cx, y / z * camera.fy + camera.cy
    np.testing.assert_allclose(columns / 4, np.rint(columns / 4), atol=1e-3)
    np.testing.assert_allclose(rows / 4, np.rint(rows / 4), atol=1e-3)


@pytest.mark.parametrize(("width", "height"), [(80, 60), (161, 121), (424, 240), (1280, 720)])
def test_other_image_sizes_become_about_as_small(width, height):
    camera = Intrinsics(width, height, width * 0.9, width * 0.9, width / 2, height / 2)
    frame = DepthFrame(0.0, np.full((height, width), 2.0, np.float32), camera)
    view, points_camera = make_view(frame), view_points(frame)
    assert view.depth_m.shape == (view.intrinsics.height, view.intrinsics.width)
    assert 40 <= view.intrinsics.width <= 110
    across = points_camera[:, 0].max() - points_camera[:, 0].min()
    assert across == pytest.approx(2.0 / 0.9, rel=0.05)


def slope(noise=0.0):
    """Depth (60, 80) of a plane that leans back; noise is that of the inverse depth."""
    row, column = np.mgrid[:60, :80]
    inverse = 0.5 - 0.003 * row + 0.001 * column
    inverse += noise * np.random.default_rng(0).standard_normal(inverse.shape)
    return (1.0 / inverse).astype(np.float32)


def test_smoothing_does_not_move_a_plane():
    np.testing.assert_allclose(smooth_depth(slope())[0], slope()[::2, ::2], rtol=1e-6)


def test_smoothing_reduces_noise_to_less_than_half():
    exact, rough = slope()[::2, ::2], slope(noise=0.003)
    inside = np.s_[1:-1, 1:-1]  # the border has no neighbours on either side
    before = np.std(1.0 / rough[::2, ::2][inside] - 1.0 / exact[inside])
    after = np.std(1.0 / smooth_depth(rough)[0][inside] - 1.0 / exact[inside])
    assert after < 0.45 * before


def test_roughness_is_that_of_noise():
    """The second difference of three independent values has six times their variance."""
    assert smooth_depth(slope())[1] < 1e-6
    rough = smooth_depth(slope(noise=0.001))[1]
    assert rough == pytest.approx(0.6745 * np.sqrt(6) * 0.001, rel=0.1)


def test_smoothing_keeps_edges_and_holes():
    depth = slope(noise=0.001)
    depth[:, 40:] *= 0.8  # something in front
    depth[20:23, 10:13] = 0.0
    smooth, _ = smooth_depth(depth)
    np.testing.assert_array_equal(smooth == 0.0, depth[::2, ::2] == 0.0)
    for column in (19, 20):  # on either side of the edge
        np.testing.assert_allclose(smooth[:, column], depth[::2, 2 * column], rtol=0.02)


def test_single_missing_pixels_are_filled_in():
    """A time-of-flight camera drops single pixels, which left no normal to half of the others."""
    depth = slope()
    depth[np.random.default_rng(0).random(depth.shape) < 0.3] = 0.0
    smooth = smooth_depth(depth)[0][1:-1, 1:-1]
    assert np.mean(smooth > 0.0) > 0.9
    exact = slope()[2:-2:2, 2:-2:2]
    np.testing.assert_allclose(smooth[smooth > 0.0], exact[smooth > 0.0], rtol=1e-6)


def test_nothing_is_filled_in_across_an_edge():
    depth = slope()
    depth[:, 40:] *= 0.8  # something in front
    depth[:, 40] = 0.0
    assert not smooth_depth(depth)[0][:, 20].any()


def test_depths_out_of_range_are_dropped():
    camera = Intrinsics(80, 60, 70.0, 70.0, 40.0, 30.0)
    depth = np.full((60, 80), 9.0, np.float32)
    depth[:30] = 0.05
    frame = DepthFrame(0.0, depth, camera)
    view, points_camera = make_view(frame), view_points(frame)
    assert not view.depth_m.any()
    assert not view.normals_camera.any()
    assert points_camera.shape == (0, 3)


def test_normals_of_a_box_room_are_those_of_its_walls():
    depth = box_room_depth_mm(CAMERA, np.eye(4), (1.0, 0.8, 3.0))
    view = make_view(DepthFrame(0.0, depth, CAMERA))
    normals = view.normals_camera
    np.testing.assert_allclose(normals[30, 40], [0, 0, -1], atol=0.02)  # the wall ahead
    np.testing.assert_allclose(normals[55, 40], [0, -1, 0], atol=0.02)  # the floor; y is down
    np.testing.assert_allclose(normals[30, 3], [1, 0, 0], atol=0.02)  # the wall to the left
    lengths = np.linalg.norm(normals, axis=-1)
    assert np.isclose(lengths[lengths > 0], 1.0, atol=1e-5).all()


def test_normals_are_not_taken_over_edges_and_holes():
    x, y = np.meshgrid(np.arange(9.0) / 50, np.arange(7.0) / 50)
    z = np.where(x < 0.09, 1.0, 2.0)
    z[3, 2] = 0.0
    points = (np.dstack([x, y, np.ones_like(x)]) * z[..., None]).astype(np.float32)
    known = surface_normals(points).any(axis=-1)
    assert not known[:, 4:6].any()  # either side of the step
    assert not known[2:5, 1:4][[0, 1, 1, 1, 2], [1, 0, 1, 2, 1]].any()  # the hole and beside it
    assert known[1, 1:4].all()
    assert not known[0].any()
    assert not known[:, 0].any()


def test_the_sensor_says_what_counts_as_an_edge():
    slanted = np.broadcast_to(1000 + 20 * np.arange(160), (120, 160)).astype(np.uint16)
    frame = DepthFrame(0.0, slanted, CAMERA)
    strict = frame.with_sensor(SensorParams(edge_ratio=0.02))
    assert make_view(frame).normals_camera[30, 1:-1].any(axis=-1).all()
    # The neighbours of a pixel differ by 80 mm, which is less than 2 % of 1 m + 3 m.
    far = make_view(frame).depth_m[30, 1:-1] > 3.001
    np.testing.assert_array_equal(make_view(strict).normals_camera[30, 1:-1].any(axis=-1), far)


def test_one_view_serves_all_who_look_at_a_frame(look):
    frame, other = look(np.eye(4), 0), look(np.eye(4), 1)
    view = make_view(frame)
    assert make_view(frame) is view
    assert make_view(other) is not view
    with pytest.raises(ValueError, match="read-only"):
        view.depth_m[0, 0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        view.normals_camera[0, 0] = 1.0


@pytest.mark.parametrize("size", [(640, 480), (848, 480), (320, 240), (200, 150)])
@pytest.mark.parametrize("metres", [False, True])
def test_what_the_map_keeps_of_a_frame_makes_the_same_view(size, metres):
    width, height = size
    rng = np.random.default_rng(0)
    depth = rng.integers(0, 9000, (height, width)).astype(np.uint16)
    depth[rng.random(depth.shape) < 0.1] = 65535
    camera = Intrinsics(width, height, 500.3, 499.1, width / 2.1, height / 1.9)
    given = np.float32(0.0007) + depth / np.float32(997.0) if metres else depth
    frame = quantize_depth(DepthFrame(1.0, given, camera))
    kept = subsample(frame)
    back = restore_frame(kept, 1.0)
    assert kept.depth.size <= 200 * 150
    for ours, theirs in (
        (make_view(back).depth_m, make_view(frame).depth_m),
        (make_view(back).normals_camera, make_view(frame).normals_camera),
        (view_points(back), view_points(frame)),
    ):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(subsample(quantize_depth(back)).depth, kept.depth)


def test_depths_in_metres_are_rounded_by_a_sixteenth_of_a_millimetre_at_most():
    depth = np.random.default_rng(0).uniform(0.1, 8.0, (48, 64)).astype(np.float32)
    depth[0, :3] = np.nan, np.inf, -1.0
    rounded = quantize_depth(DepthFrame(0.0, depth, Intrinsics(64, 48, 50, 50, 32, 24)))
    np.testing.assert_allclose(rounded.depth_m()[1:], depth[1:], rtol=0, atol=6.3e-5)
    assert not rounded.depth_m()[0, :3].any()


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_depths_up_to_the_largest_of_the_sensor_are_kept(dtype):
    depth = np.full((120, 160), 10_000 if dtype == np.uint16 else 10.0, dtype)
    depth[:, 80:] *= 2
    frame = quantize_depth(DepthFrame(0.0, depth, CAMERA, SensorParams(max_depth_m=12.0)))
    restored = restore_frame(subsample(frame))
    kept = restored.depth_m()[restored.depth_m() > 0]
    np.testing.assert_allclose(kept, 10.0, atol=1e-3)
    np.testing.assert_array_equal(make_view(restored).depth_m, make_view(frame).depth_m)
    np.testing.assert_array_equal(view_points(restored), view_points(frame))
    np.testing.assert_array_equal(subsample(restored).depth, subsample(frame).depth)
    assert not subsample(frame.with_sensor(SensorParams())).depth.any()
