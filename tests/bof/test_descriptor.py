import cv2
import numpy as np
import oracle
import pytest
from hypothesis import assume, given, settings, strategies as st
from hypothesis.extra.numpy import arrays

from slam_bof.bof import BofParams, ContourParams, describe, find_contours
from slam_bof.types import Contours

pixels = st.integers(-50, 300)
polygons = st.integers(1, 12).flatmap(lambda n: arrays(np.int32, (n, 2), elements=pixels))


def contours_of(*points_px):
    return Contours(
        tuple(np.asarray(points, np.int32) for points in points_px),
        np.zeros(len(points_px), np.int32),
    )


def ellipse(a, b, n=400):
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.stack([a * np.cos(angle), b * np.sin(angle)], axis=1).round()


@given(st.lists(polygons, min_size=1, max_size=4))
def test_descriptors_equal_the_oracle(shapes):
    # Areas that almost vanish put the centroid anywhere, where both lose precision.
    assume(all(not 0 < abs(oracle.shoelace(p.tolist())) < 50 for p in shapes))
    descriptors = describe(contours_of(*shapes), BofParams(n_points=30))
    expected = [oracle.bof(shape, 30) for shape in shapes]
    np.testing.assert_allclose(descriptors, expected, atol=1e-5)


def test_a_point_among_others_is_a_point():
    """Rounding of the one walked before must not become radii."""
    tangle = [[10, -49], [137, 109], [137, 137], [30, 137], [-8, 137], [137, 84], [137, 137]]
    shapes = [np.array(tangle, np.int32), np.zeros((1, 2), np.int32)]
    assert not describe(contours_of(*shapes), BofParams(n_points=30))[1].any()


@given(arrays(np.int32, (20,), elements=st.integers(20, 100)), st.booleans())
def test_descriptors_by_angle_equal_the_oracle(radii, clockwise):
    angle = np.linspace(0.1, 2 * np.pi + 0.1, 20, endpoint=False) * (1 if clockwise else -1)
    star = np.stack([radii * np.cos(angle), radii * np.sin(angle)], axis=1).round().astype(np.int32)
    descriptor = describe(contours_of(star), BofParams(n_points=29, sampling="angle"))[0]
    expected = np.array(oracle.bof(star, 29, "angle"))
    # Rounding decides whether a ray meets a corner that it only touches.
    assert (np.abs(descriptor - expected) > 1e-5).sum() <= 1


@given(st.lists(polygons, min_size=1, max_size=4), st.sampled_from(["arc", "angle"]))
def test_any_polygon_gives_finite_radii_up_to_one(shapes, sampling):
    descriptors = describe(contours_of(*shapes), BofParams(sampling=sampling))
    assert descriptors.dtype == np.float32
    assert np.isfinite(descriptors).all()
    assert (descriptors >= 0).all()
    largest = descriptors.max(axis=1)
    assert set(largest.tolist()) <= {0.0, 1.0}


@given(st.integers(40, 200), st.integers(-100, 100), st.integers(-100, 100))
def test_a_circle_is_constant(radius, x, y):
    circle = ellipse(radius, radius) + np.array([x, y])
    np.testing.assert_allclose(describe(contours_of(circle), BofParams()), 1.0, atol=2 / radius)


@given(st.integers(1, 6), pixels, pixels, polygons)
def test_scale_and_place_change_nothing(scale, x, y, shape):
    plain, changed = describe(contours_of(shape, scale * shape + [x, y]), BofParams())
    np.testing.assert_allclose(plain, changed, atol=2e-3)


def test_a_turned_square_matches_after_alignment():
    side = np.arange(100)
    zero, full = np.zeros(100, int), np.full(100, 100)
    square = np.concatenate(
        [
            np.stack([side, zero], 1),
            np.stack([full, side], 1),
            np.stack([100 - side, full], 1),
            np.stack([zero, 100 - side], 1),
        ]
    )
    diamond = square @ np.array([[1, 1], [-1, 1]])  # by 45 degrees, larger by sqrt(2)
    a, b = describe(contours_of(square, np.roll(diamond, 37, axis=0)), BofParams())
    errors = [np.abs(a - np.roll(b, shift)).max() for shift in range(180)]
    assert min(errors) < 0.02


@pytest.mark.parametrize("sampling", ["arc", "angle"])
@pytest.mark.parametrize("start", ["farthest", "fourier"])
@given(turn=st.floats(0, 2 * np.pi))
@settings(max_examples=25)
def test_a_turned_shape_keeps_its_descriptor(sampling, start, turn):
    angle = np.linspace(0, 2 * np.pi, 2000, endpoint=False)
    radius = 1e4 * (1 + 0.4 * np.cos(angle) + 0.2 * np.sin(3 * angle))
    shape, turned = (radius * np.exp(1j * (angle + by)) for by in (0.0, turn))
    params = BofParams(sampling=sampling, start=start)
    a, b = describe(
        contours_of(*(np.stack([z.real, z.imag], 1).round() for z in (shape, turned))), params
    )
    assert a.shape == (params.n_values,)
    np.testing.assert_allclose(a, b, atol=0.03)


def test_farthest_begins_at_the_largest_radius_and_fourier_keeps_the_mean():
    shape = contours_of(ellipse(60, 20)[100:])
    radii, farthest, fourier = (
        describe(shape, BofParams(start=start))[0] for start in ("found", "farthest", "fourier")
    )
    assert farthest[0] == 1.0
    np.testing.assert_array_equal(farthest, np.roll(radii, -radii.argmax()))
    assert fourier.shape == (91,)
    assert fourier[0] == pytest.approx(radii.mean(), abs=1e-6)


def test_by_angle_a_square_has_the_radii_of_its_sides():
    square = contours_of([[0, 0], [0, 20], [20, 20], [20, 0]])
    radii = describe(square, BofParams(n_points=8, sampling="angle"))[0]
    np.testing.assert_allclose(radii, [0.5**0.5, 1.0] * 4, atol=1e-6)


def test_by_angle_a_centroid_outside_sees_nothing_on_the_open_side():
    crescent = ellipse(500, 500, 4000)[:2001].tolist() + ellipse(480, 480, 4000)[2000::-1].tolist()
    radii = describe(contours_of(crescent), BofParams(n_points=36, sampling="angle"))[0]
    assert (radii == 0.0).any()
    assert radii.max() == 1.0


def test_order_is_counter_clockwise_as_seen():
    # A kite whose far tip points up on a screen (y down): from the right tip, that is a
    # quarter turn counter-clockwise.
    right, up, left, down = [30, 0], [0, -60], [-30, 0], [0, 30]
    shapes = contours_of([right, up, left, down], [right, down, left, up])
    a, b = describe(shapes, BofParams(n_points=60))
    np.testing.assert_allclose(a, b, atol=1e-6)
    assert 10 < a.argmax() < 30


def test_opencv_contours_start_as_found():
    image = np.zeros((60, 60), np.uint8)
    cv2.ellipse(image, (30, 30), (25, 10), 0, 0, 360, 1, -1)
    (contour,), _ = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    descriptor = describe(contours_of(contour[:, 0]), BofParams())[0]
    start = np.hypot(*(contour[0, 0] - 30))
    assert descriptor[0] == pytest.approx(start / 25, abs=0.02)
    assert contour[0, 0, 1] == 20  # which OpenCV finds in the topmost row


def test_degenerate_contours_are_defined():
    point = [[5, 5]]
    line = [[0, 0], [1, 0], [2, 0], [3, 0], [4, 0], [3, 0], [2, 0], [1, 0]]
    crescent = ellipse(50, 50)[:300].tolist() + ellipse(45, 45)[:300][::-1].tolist()
    descriptors = describe(contours_of(point, line, crescent), BofParams(n_points=8))
    assert descriptors[0].tolist() == [0.0] * 8
    assert descriptors[1].tolist() == [1.0, 0.5, 0.0, 0.5, 1.0, 0.5, 0.0, 0.5]
    assert np.isfinite(descriptors[2]).all()


def test_a_contour_that_touches_itself_is_defined():
    # Two squares of one image that meet in a corner are followed as one contour.
    image = np.zeros((40, 40), np.uint8)
    image[5:15, 5:15] = image[15:25, 15:25] = 1
    (contour,), _ = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    for sampling in ("arc", "angle"):
        descriptor = describe(contours_of(contour[:, 0]), BofParams(sampling=sampling))[0]
        assert np.isfinite(descriptor).all()
        # Half a turn takes the shape to itself.
        halves = descriptor.reshape(2, -1)
        np.testing.assert_allclose(halves[0], halves[1], atol=0.05)
    # A bow tie's areas cancel out: its centroid is that of the line it draws.
    bow_tie = describe(contours_of([[0, 0], [20, 20], [20, 0], [0, 20]]), BofParams())[0]
    assert np.isfinite(bow_tie).all()
    assert bow_tie.max() == 1.0
    assert bow_tie.min() < 0.02


def test_a_contour_on_the_images_border_is_like_any_other():
    shape = np.zeros((2, 60, 60), np.uint8)
    shape[0, :30, :40] = 1  # in the corner
    shape[1, 15:45, 10:50] = 1  # in the middle
    found = find_contours(shape, ContourParams())
    corner, middle = describe(found, BofParams())
    np.testing.assert_allclose(corner, middle, atol=1e-6)


def test_descriptors_do_not_depend_on_their_neighbours():
    shapes = [ellipse(30, 20), [[1, 1]], ellipse(10, 40)[::-1], ellipse(5, 5)]
    together = describe(contours_of(*shapes), BofParams())
    alone = np.concatenate([describe(contours_of(shape), BofParams()) for shape in shapes])
    np.testing.assert_allclose(together, alone, atol=1e-6)


def test_no_contours_give_no_descriptors():
    descriptors = describe(Contours((), np.empty(0, np.int32)), BofParams(n_points=7))
    assert descriptors.shape == (0, 7)
    assert descriptors.dtype == np.float32


def test_an_empty_contour_is_refused():
    with pytest.raises(ValueError, match="at least one point"):
        describe(contours_of(np.empty((0, 2))), BofParams())
