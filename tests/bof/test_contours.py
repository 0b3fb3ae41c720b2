import cv2
import numpy as np
import oracle
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from pydantic import ValidationError

from slam_bof.bof import (
    ContourParams,
    LayerParams,
    find_contours,
    layer_contours,
    layer_images,
)

EVERYTHING = ContourParams(closing_px=1, min_area_share=0.0)


@given(
    arrays(np.uint8, (3, 14, 14), elements=st.sampled_from([0, 0, 1])),
    st.sampled_from([1, 3, 5]),
    st.sampled_from([0.0, 0.01, 0.1]),
)
def test_contours_equal_the_oracle(images, closing_px, min_area_share):
    params = ContourParams(closing_px=closing_px, min_area_share=min_area_share)
    contours = find_contours(images, params)
    expected = oracle.find_contours(images, closing_px, min_area_share)
    assert contours.layer.tolist() == [layer for layer, _ in expected]
    for corners, (_, every_pixel) in zip(contours.points_px, expected, strict=True):
        np.testing.assert_array_equal(with_pixels_between(corners), every_pixel)


def with_pixels_between(corners):
    """The 8-connected pixels of a closed polygon, from its first corner."""
    pixels = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        n_steps = max(np.abs(b - a).max(), 1)
        pixels += [a + (b - a) * i // n_steps for i in range(n_steps)]
    return np.array(pixels)


@pytest.mark.parametrize("margin_px", [1, 3, 5])
def test_a_margin_that_is_there_already_changes_nothing(margin_px):
    images = (np.random.default_rng(0).random((3, 20, 20)) < 0.3).astype(np.uint8)
    margins = ((0, 0), (margin_px, margin_px), (margin_px, margin_px))
    params = ContourParams(min_area_share=0.02)
    plain = find_contours(images, params)
    padded = find_contours(np.pad(images, margins), params, margin_px=margin_px)
    assert len(plain) > 0
    assert padded.layer.tolist() == plain.layer.tolist()
    for a, b in zip(padded.points_px, plain.points_px, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("closing_px", [1, 5])
def test_contours_of_layers_are_those_of_their_images(closing_px):
    points = np.random.default_rng(2).normal(size=(3000, 3)).astype(np.float32)
    layers = LayerParams(n_layers=4, resolution_px=61)
    params = ContourParams(closing_px=closing_px, min_area_share=0.0)
    found = layer_contours(points, layers, params)
    expected = find_contours(layer_images(points, layers), params)
    assert len(found) > 10
    assert found.layer.tolist() == expected.layer.tolist()
    for ours, theirs in zip(found.points_px, expected.points_px, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_rectangle_is_found_in_its_place():
    images = np.zeros((2, 30, 20), np.uint8)
    images[1, 4:10, 3:15] = 1  # rows 4..9, columns 3..14
    contours = find_contours(images, ContourParams())
    assert contours.layer.tolist() == [1]
    points_px = contours.points_px[0]
    assert points_px.dtype == np.int32
    assert points_px.min(axis=0).tolist() == [3, 4]
    assert points_px.max(axis=0).tolist() == [14, 9]
    assert cv2.contourArea(points_px) == 11 * 5


def test_closing_joins_what_is_near_and_keeps_layers_apart():
    images = np.zeros((2, 20, 20), np.uint8)
    images[0, 2:12, [3, 6]] = 1
    images[0, 17:20, 3:17] = 1  # at the lower border of the first layer
    images[1, 0:3, 3:17] = 1  # at the upper border of the second
    closed = find_contours(images, ContourParams(closing_px=5, min_area_share=0.0))
    assert closed.layer.tolist() == [0, 0, 1]
    assert len(find_contours(images, EVERYTHING)) == 4


@pytest.mark.parametrize(("share", "n_kept"), [(0.01, 1), (0.0101, 0)])
def test_area_threshold_is_inclusive(share, n_kept):
    images = np.zeros((1, 30, 30), np.uint8)
    images[0, 10:14, 10:14] = 1  # 3 x 3 pixels between centres: 9 of 900
    assert len(find_contours(images, ContourParams(min_area_share=share))) == n_kept


def test_degenerate_contours_are_kept_if_asked_for():
    images = np.zeros((1, 10, 10), np.uint8)
    images[0, 2, 2] = 1
    images[0, 5, 1:9] = 1
    contours = find_contours(images, EVERYTHING)
    assert sorted(len(points_px) for points_px in contours.points_px) == [1, 2]


def test_nothing_drawn_gives_no_contours():
    for images in (np.zeros((20, 30, 30), np.uint8), np.zeros((0, 30, 30), np.uint8)):
        contours = find_contours(images, ContourParams())
        assert len(contours) == 0
        assert contours.layer.shape == (0,)


def test_bad_arguments_are_refused():
    with pytest.raises(ValueError, match=r"must be \(L, H, W\), got \(4, 4\)"):
        find_contours(np.zeros((4, 4), np.uint8), ContourParams())
    with pytest.raises(ValidationError, match="closing_px must be odd, got 4"):
        ContourParams(closing_px=4)
