import cv2
import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.bof import PlaceParams, descriptors
from slam_bof.core import registry
from slam_bof.geometry import se3
from slam_bof.testing import check_descriptor
from slam_bof.types import DepthFrame
from slam_bof_plugins.descriptor_bof import BofFernDescriptor, BofFernParams

FRAME = DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)


def speckle(seed):
    noise = np.random.default_rng(seed).integers(0, 256, (60, 80)).astype(np.uint8)
    return cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC)


def test_options_reach_the_descriptor():
    few = registry.build("descriptors", "orb", {"n_features": 20})
    assert len(few.describe(FRAME, speckle(1))) <= 20
    layers = registry.build("descriptors", "bof", {"layers": {"n_layers": 3}})
    params = PlaceParams.model_validate({"layers": {"n_layers": 3}})
    np.testing.assert_array_equal(layers.describe(FRAME, None), descriptors(FRAME, params))


def test_a_thumbnail_is_the_depth_in_metres():
    frame = DepthFrame(0.0, np.full_like(FRAME.depth, 2500), CAMERA)
    thumbnail = registry.build("descriptors", "thumbnail").describe(frame, None)
    np.testing.assert_allclose(thumbnail, 2.5, rtol=1e-6)


def test_occupancy_forgives_a_small_step_more_than_a_large_one():
    occupancy = registry.build("descriptors", "occupancy")
    near, step, far = (
        occupancy.describe(DepthFrame(0.0, box_room_depth_mm(CAMERA, T), CAMERA), None)[0]
        for T in (se3.exp(np.array([0, 0, 0, x, 0, 0])) for x in (0.0, 0.1, 0.6))
    )
    assert near @ step > near @ far


def test_ferns_ask_the_same_questions_for_a_seed():
    first, again, other = (
        registry.build("descriptors", "ferns", {"seed": seed}).describe(FRAME, None)
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


def test_ferns_on_bof_are_one_bit_for_each_radius():
    ferns = BofFernDescriptor(BofFernParams(seed=3))
    codes = np.unpackbits(ferns.describe(FRAME, None), axis=1)[:, :180]
    radii = descriptors(FRAME, PlaceParams())
    assert codes.shape == radii.shape
    # Within a column all share a threshold: whatever has a 1 is larger than whatever has a 0.
    smallest_of_ones = np.where(codes == 1, radii, np.inf).min(axis=0)
    assert (smallest_of_ones > np.where(codes == 0, radii, -np.inf).max(axis=0)).all()
    assert 0.2 < codes.mean() < 0.8
    check_descriptor(lambda: BofFernDescriptor(BofFernParams()))


def stripes(angle, cycles):
    """A grey image of bars whose brightness changes along ``angle``, so many times."""
    y, x = np.mgrid[:256, :256] / 256
    wave = np.cos(2 * np.pi * cycles * (x * np.cos(angle) + y * np.sin(angle)))
    return (127 + 100 * wave).astype(np.uint8)


@pytest.mark.parametrize("scale", range(4))
@pytest.mark.parametrize("orientation", range(8))
def test_gist_depends_on_scale_and_direction(scale, orientation):
    gray = stripes(np.pi * orientation / 8, 128 * 0.3 / 1.85**scale)
    gist = registry.build("descriptors", "gist").describe(FRAME, gray).reshape(4, 8, 16)
    strongest = gist.mean(axis=2).argmax()
    assert np.unravel_index(strongest, (4, 8)) == (scale, orientation)


def test_gist_depends_on_position():
    gray = np.full((256, 256), 127, np.uint8)
    gray[64:128, 128:192] = stripes(0.0, 38)[64:128, 128:192]
    gist = registry.build("descriptors", "gist").describe(FRAME, gray).reshape(32, 4, 4)
    assert np.unravel_index(gist[0].argmax(), (4, 4)) == (1, 2)


def test_gist_of_a_darker_and_duller_image_is_much_the_same():
    gist = registry.build("descriptors", "gist", {"min_contrast": 0.01})
    bright, dull, other = (
        gist.describe(FRAME, gray)[0]
        for gray in (speckle(0) // 2 + 100, speckle(0) // 8 + 60, speckle(1) // 2 + 100)
    )
    assert np.abs(bright - dull).mean() < 0.5 * np.abs(bright - other).mean()


def test_gist_of_depth_sees_through_holes():
    gist = registry.build("descriptors", "gist-depth")
    holed = FRAME.depth.copy()
    holed[100:112, 150:162] = 0
    whole, patched, flat = (
        gist.describe(DepthFrame(0.0, depth, CAMERA), None)[0]
        for depth in (FRAME.depth, holed, np.full_like(FRAME.depth, 2500))
    )
    np.testing.assert_allclose(flat, 0.0, atol=1e-3)
    assert np.abs(whole - patched).mean() < 0.05 * np.abs(whole - flat).mean()


def test_size_of_the_gist_is_that_of_its_parameters():
    options = {"n_blocks": 3, "block_px": 20, "n_scales": 2, "n_orientations": 6}
    few = registry.build("descriptors", "gist", options)
    assert few.describe(FRAME, speckle(0)).shape == (1, 3 * 3 * 2 * 6)


def test_a_row_holds_the_largest_contour_of_every_layer():
    params = PlaceParams.model_validate(
        {"layers": {"n_layers": 4}, "bof": {"n_points": 12, "sampling": "angle"}}
    )
    options = params.model_dump(mode="json")
    row = registry.build("descriptors", "bof-layers", options).describe(FRAME, None)
    assert row.shape == (1, 4 * 12)
    found = descriptors(FRAME, params)
    for layer in row.reshape(4, 12):
        assert (layer == 0).all() or (found == layer).all(axis=1).any()
    assert (row.reshape(4, 12).max(axis=1) == 1).any()
