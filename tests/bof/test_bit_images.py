import cv2
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays

from slam_bof.bof.bit_images import close, dilate, outer_contours, pack_bits, unpack_bits

MARGIN_PX = 4


@st.composite
def sheets(draw):
    """Images (H, W) with an empty margin, of noise and of frames that other things lie in."""
    height, width = draw(st.integers(1, 40)), draw(st.integers(1, 70))
    image = draw(arrays(np.uint8, (height, width), elements=st.sampled_from([0, 0, 0, 1])))
    for _ in range(draw(st.integers(0, 3))):
        top, left = draw(st.integers(0, height)), draw(st.integers(0, width))
        image[top : top + 12, left : left + 12] = 1
        image[top + 2 : top + 10, left + 2 : left + 10] = 0
        image[top + 4 : top + 7, left + 4 : left + 7] = 1
    return np.pad(image, MARGIN_PX)


@given(sheets())
def test_bits_are_pixels(image):
    words = pack_bits(image)
    assert words.dtype == np.uint32
    np.testing.assert_array_equal(unpack_bits(words, image.shape[1]), image)


@given(sheets(), st.integers(0, 3))
def test_morphology_equals_opencv(image, radius_px):
    kernel = np.ones((2 * radius_px + 1, 2 * radius_px + 1), np.uint8)
    for ours, theirs in ((close, cv2.MORPH_CLOSE), (dilate, cv2.MORPH_DILATE)):
        words = pack_bits(image)
        ours(words, radius_px)
        expected = cv2.morphologyEx(image, theirs, kernel)
        np.testing.assert_array_equal(unpack_bits(words, image.shape[1]), expected)


@pytest.mark.parametrize("min_area_px", [0.0, 4.0, 30.0])
@given(sheets())
def test_contours_equal_opencv(min_area_px, image):
    corners, counts = outer_contours(pack_bits(image), min_area_px)
    found, _ = cv2.findContours(image, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    expected = [points[:, 0] for points in found if cv2.contourArea(points) >= min_area_px]
    assert counts.tolist() == [len(points) for points in expected]
    assert corners.tolist() == [corner.tolist() for points in expected for corner in points]


def test_many_and_long_contours_are_all_found():
    dots = np.zeros((70, 70), np.uint8)
    dots[2:68:2, 2:68:2] = 1
    assert outer_contours(pack_bits(dots), 0.0)[1].tolist() == [1] * 33 * 33
    comb = np.zeros((1100, 9), np.uint8)
    comb[1:-1, 2] = comb[1:-1:2, 3:7] = 1
    corners, counts = outer_contours(pack_bits(comb), 1.0)
    found, _ = cv2.findContours(comb, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    assert counts.tolist() == [len(found[0])]
    assert len(corners) > 1024
    np.testing.assert_array_equal(corners, found[0][:, 0])


@pytest.mark.parametrize("shape", [(0, 3), (1, 1), (2, 1), (3, 1), (9, 2)])
def test_the_outermost_pixels_count_as_clear(shape):
    corners, counts = outer_contours(np.full(shape, 0xFFFFFFFF, np.uint32), 0.0)
    height, width = shape[0], 32 * shape[1]
    if height < 3:
        assert len(counts) == len(corners) == 0
    else:
        assert corners.min(axis=0).tolist() == [1, 1]
        assert corners.max(axis=0).tolist() == [width - 2, height - 2]
