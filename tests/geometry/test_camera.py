import numpy as np
import oracle
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from slam_bof.geometry import PointParams, back_project, points_camera, points_camera_f32
from slam_bof.types import DepthFrame, Intrinsics

CAMERA = Intrinsics(width=9, height=7, fx=10.0, fy=11.0, cx=4.2, cy=3.1)


@given(
    arrays(np.uint16, (7, 9), elements=st.sampled_from([0, 400, 1000, 2345, 65535])),
    st.integers(1, 4),
)
def test_points_equal_the_oracle(depth, stride):
    frame = DepthFrame(0.0, depth, CAMERA)
    points = back_project(frame.depth_m(stride), CAMERA, stride)
    assert points.dtype == np.float64
    np.testing.assert_allclose(points, oracle.back_project(frame.depth_m(stride), CAMERA, stride))


def test_points_project_back_to_their_pixels():
    depth = np.full((7, 9), 2000, np.uint16)
    x, y, z = back_project(DepthFrame(0.0, depth, CAMERA).depth_m(2), CAMERA, 2).T
    u = CAMERA.fx * x / z + CAMERA.cx
    v = CAMERA.fy * y / z + CAMERA.cy
    np.testing.assert_allclose(u.reshape(4, 5)[0], [0, 2, 4, 6, 8], atol=1e-9)
    np.testing.assert_allclose(v.reshape(4, 5)[:, 0], [0, 2, 4, 6], atol=1e-9)


def test_points_out_of_range_are_dropped():
    depth = np.zeros((7, 9), np.float32)
    depth[0, :4] = [0.5, 1.0, 3.0, 3.5]
    params = PointParams(stride=1, min_range_m=1.0, max_range_m=3.0)
    assert points_camera(DepthFrame(0.0, depth, CAMERA), params)[:, 2].tolist() == [1.0, 3.0]
    assert depth[0, 0] == 0.5  # the frame is left as it was


def test_single_precision_agrees_with_double():
    depth = np.arange(63, dtype=np.uint16).reshape(7, 9) * 50
    frame = DepthFrame(0.0, depth, CAMERA)
    single = points_camera_f32(frame, PointParams())
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, points_camera(frame, PointParams()), rtol=1e-6)


@pytest.mark.parametrize("points_of", [points_camera, points_camera_f32])
@pytest.mark.parametrize("missing", [0, 65535])
def test_nothing_seen_gives_no_points(points_of, missing):
    frame = DepthFrame(0.0, np.full((7, 9), missing, np.uint16), CAMERA)
    assert points_of(frame, PointParams(min_range_m=0.0)).shape == (0, 3)


def test_wrong_shape_is_refused():
    with pytest.raises(ValueError, match=r"must be \(4, 5\) at stride 2.*got \(7, 9\)"):
        back_project(np.ones((7, 9)), CAMERA, 2)


def test_range_limits_in_the_wrong_order_are_refused():
    with pytest.raises(ValidationError, match="min_range_m must be below max_range_m"):
        PointParams(min_range_m=2.0, max_range_m=1.0)
