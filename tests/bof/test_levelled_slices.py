import numpy as np
import pytest
from pydantic import ValidationError

from slam_bof.bof.bit_images import unpack_bits
from slam_bof.bof.levelled_slices import SliceParams, draw_slices, find_slice_contours
from slam_bof.bof.polygons import Polygons

PARAMS = SliceParams()


def box(centre, size, step=0.015):
    """Points (N, 3) that fill a box in the levelled frame."""
    axes = [np.arange(c - s / 2, c + s / 2, step) for c, s in zip(centre, size, strict=True)]
    return np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 3).astype(np.float32)


def test_a_pixel_is_drawn_where_a_slice_has_two_points():
    one_each = np.array([[0, 0.05, 2], [0, 0.15, 2], [1, 0.05, 2]], np.float32)
    images = unpack_bits(draw_slices(one_each, PARAMS), PARAMS.side_px + 2 * PARAMS.margin_px)
    # Heights 0.05 and 0.15 m are the 15th and 16th slab, which only slice 14 holds both of.
    np.testing.assert_array_equal(np.flatnonzero(images.any(axis=(1, 2))), [14])
    assert images.sum() == 1


def test_a_contour_lies_where_the_thing_is():
    found = find_slice_contours(box((0.5, 0.3, 2.0), (0.6, 0.5, 0.4)), PARAMS)
    polygons = Polygons(found.corners_m, found.counts)
    # From 0.05 to 0.55 m below the camera: slices that begin at -0.1 ... 0.5 m.
    np.testing.assert_array_equal(np.sort(found.slices), np.arange(13, 20))
    np.testing.assert_allclose(polygons.centroids, 0.5 + 2.0j, atol=0.03)
    expected = np.hypot(0.3, 0.2) + 0.04 * np.sqrt(2)  # dilation
    np.testing.assert_allclose(polygons.largest_radii(), expected, atol=0.05)


def test_things_in_other_slices_stay_apart():
    low, high = box((0, 1.0, 2.0), (0.5, 0.2, 0.5)), box((0, -1.0, 3.0), (0.5, 0.2, 0.5))
    found = find_slice_contours(np.concatenate([low, high]), PARAMS)
    z = Polygons(found.corners_m, found.counts).centroids.imag
    np.testing.assert_allclose(z, np.where(found.slices < 15, 3.0, 2.0), atol=0.03)


@pytest.mark.parametrize("far", [(0, 0, 20), (0, 9, 2), (-20, 0, 2), (0, -9, 2)])
def test_what_lies_outside_is_not_drawn(far):
    found = find_slice_contours(box(far, (0.4, 0.4, 0.4)), PARAMS)
    assert len(found.slices) == len(found.corners_m) == 0


def test_points_at_the_rim_are_drawn_whole():
    half = PARAMS.side_m / 2
    rim = box((-half + 0.2, PARAMS.top_m + 0.1, PARAMS.ahead_m - half + 0.2), (0.4, 0.18, 0.4))
    found = find_slice_contours(rim, PARAMS)
    assert 0 in found.slices
    np.testing.assert_allclose(
        Polygons(found.corners_m, found.counts).largest_radii(), 0.2 * np.sqrt(2) + 0.05, atol=0.05
    )


def test_kernels_are_odd():
    with pytest.raises(ValidationError, match="closing_px must be odd, got 4"):
        SliceParams(closing_px=4)
