import math

import numpy as np
import oracle
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from slam_bof.bof import LayerParams, layer_images
from slam_bof.bof.layers import _coordinates, layer_index

coordinates = st.floats(-8, 8, width=32)
clouds = st.integers(0, 40).flatmap(
    lambda n: (
        arrays(np.float32, (n, 3), elements=coordinates)
        | arrays(np.float64, (n, 3), elements=coordinates)
    )
)


@given(clouds, st.integers(1, 6), st.sampled_from(["floor", "nearest"]))
def test_images_and_layers_equal_the_oracle(points, n_layers, rounding):
    params = LayerParams(n_layers=n_layers, resolution_px=12, rounding=rounding)
    expected = oracle.layer_index(list(points), n_layers, rounding)
    assert layer_index(points, params).tolist() == expected
    images = layer_images(points, params)
    assert images.dtype == np.uint8
    np.testing.assert_array_equal(images, oracle.layer_images(points, n_layers, rounding, 12))


@given(clouds, st.integers(1, 30))
def test_layers_partition_the_points(points, n_layers):
    params = LayerParams(n_layers=n_layers)
    index = layer_index(points, params)
    assert index.shape == (len(points),)
    assert ((index >= 0) & (index < n_layers)).all()
    order = np.argsort(points[:, 2], kind="stable")
    assert (np.diff(index[order]) >= 0).all()
    if len(points) and np.ptp(points[:, 2]) > 1e-3:
        assert index[points[:, 2].argmin()] == 0
        assert index[points[:, 2].argmax()] == n_layers - 1


def test_nearest_has_ends_of_half_a_layer():
    points = np.array([[0, 0, z] for z in (0.0, 0.4, 0.6, 1.4, 1.6, 2.0)])
    params = LayerParams(n_layers=2, rounding="nearest")
    assert layer_index(points, params).tolist() == [0, 0, 1, 1, 2, 2]
    assert len(layer_images(points, params)) == params.n_images == 3


def test_layers_follow_any_axis():
    points = np.random.default_rng(0).normal(size=(50, 3))
    along_x = layer_index(points, LayerParams(n_layers=5, axis=(2.0, 0.0, 0.0)))
    turned = points[:, [1, 2, 0]]
    assert along_x.tolist() == layer_index(turned, LayerParams(n_layers=5)).tolist()


@given(clouds, st.integers(1, 6), st.floats(0.05, 3.0), st.floats(-5, 5))
def test_layers_of_fixed_thickness_hold_what_lies_in_them(points, n_layers, thickness_m, start_m):
    params = LayerParams(n_layers=n_layers, thickness_m=thickness_m, start_m=start_m)
    index = layer_index(points, params)
    for point, layer in zip(points, index, strict=True):
        dtype = point.dtype.type
        expected = math.floor((point[2] - dtype(start_m)) / dtype(thickness_m))
        assert layer == (expected if 0 <= expected < n_layers else -1)


def test_things_keep_their_size_in_metric_images():
    params = LayerParams(n_layers=2, resolution_px=10, thickness_m=1.0, start_m=1.0, pixel_m=0.1)
    thing = np.array([[0.0, 0.0, 1.5], [0.2, 0.1, 1.5]])
    others = np.array([[3.0, 0.0, 1.2], [-0.6, 0.0, 1.2], [0.0, 0.0, 3.5], [0.0, 0.45, 0.5]])
    for points in (thing, np.concatenate([thing, others])):
        images = layer_images(points, params)
        assert np.argwhere(images).tolist() == [[0, 5, 5], [0, 6, 7]]


def test_layers_along_gravity_do_not_tilt_with_the_camera():
    level = np.random.default_rng(3).uniform((-1, -1, 2), (1, 1, 4), (300, 3))
    params = LayerParams(n_layers=4, resolution_px=15, axis="gravity", plane="axis")
    tilt = 0.4
    R_camera_level = np.array(
        [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]]
    )
    down = np.array([0.0, 1.0, 0.0])
    straight = layer_images(level, params, gravity_camera=down)
    tilted = layer_images(level @ R_camera_level.T, params, gravity_camera=R_camera_level @ down)
    np.testing.assert_array_equal(straight, tilted)
    assert straight.any(axis=(1, 2)).all()
    with pytest.raises(ValueError, match="layers along gravity need gravity_camera"):
        layer_images(level, params)


@pytest.mark.parametrize("axis", [(0.0, 0.0, -2.0), (0.3, -0.4, 0.5), (0.0, 1.0, 0.0)])
def test_the_plane_across_the_axis_is_right_handed(axis):
    unit = np.array(axis) / np.linalg.norm(axis)
    points = np.array([[0, 0, 0], unit, [0.5, 0.2, 0.1]])
    x, y, height = _coordinates(points, LayerParams(axis=axis, plane="axis"), None)
    np.testing.assert_allclose([x[1], y[1], height[1]], [0, 0, 1], atol=1e-12)
    assert np.hypot(np.hypot(x[2], y[2]), height[2]) == pytest.approx(np.linalg.norm(points[2]))


def test_many_layers_are_kept_apart():
    points = np.array([[0, 0, z] for z in np.arange(1000.0)])
    index = layer_index(points, LayerParams(n_layers=1000))
    assert (np.diff(index) >= 0).all()
    assert index[0] == 0
    assert index[-1] == 999


@pytest.mark.parametrize("margin_px", [0, 2])
def test_the_margin_is_empty(margin_px):
    points = np.random.default_rng(4).normal(size=(200, 3))
    images = layer_images(points, LayerParams(n_layers=3, resolution_px=9), margin_px=margin_px)
    assert images.shape == (3, 9 + 2 * margin_px, 9 + 2 * margin_px)
    inner = images[:, margin_px : margin_px + 9, margin_px : margin_px + 9]
    assert inner.sum() == images.sum()
    np.testing.assert_array_equal(
        inner, layer_images(points, LayerParams(n_layers=3, resolution_px=9))
    )


def test_flat_clouds_have_a_defined_image():
    size = LayerParams().resolution_px
    line = np.array([[1.0, y, 2.0] for y in (0.0, 0.5, 1.0)])
    images = layer_images(line, LayerParams(n_layers=3))
    assert np.argwhere(images).tolist() == [[0, 0, 0], [0, (size) // 2, 0], [0, size - 1, 0]]
    point = np.full((4, 3), 1.0)
    assert np.argwhere(layer_images(point, LayerParams())).tolist() == [[0, 0, 0]]


def test_the_image_spans_the_layer():
    points = np.random.default_rng(1).uniform(-2, 2, (500, 3)).astype(np.float32)
    for image in layer_images(points, LayerParams(n_layers=4, resolution_px=20)):
        assert image[0].any()
        assert image[-1].any()
        assert image[:, 0].any()
        assert image[:, -1].any()


def test_no_points_give_empty_images():
    images = layer_images(np.empty((0, 3)), LayerParams(n_layers=4, resolution_px=8))
    assert images.shape == (4, 8, 8)
    assert not images.any()
    assert layer_index(np.empty((0, 3)), LayerParams()).shape == (0,)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"must be \(N, 3\), got \(3,\)"):
        layer_images(np.zeros(3), LayerParams())
    with pytest.raises(ValidationError, match="axis must be a direction"):
        LayerParams(axis=(0.0, 0.0, 0.0))
    with pytest.raises(ValidationError, match="got 60000 of 300 x 300"):
        LayerParams(n_layers=60000)
    with pytest.raises(ValidationError, match="'nearest' is for layers without thickness_m"):
        LayerParams(rounding="nearest", thickness_m=0.1)
