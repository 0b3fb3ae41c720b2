import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from slam_bof.layers import LayerParams, layer_images, layer_index

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
