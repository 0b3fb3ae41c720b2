import cv2
import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof import ports, registry, se3
from slam_bof.places import PlaceParams, descriptors
from slam_bof.types import DepthFrame

FRAME = DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)


LOCAL = ["bof", "orb", "sift"]
GLOBAL = ["ferns", "gist", "gist-depth", "occupancy", "thumbnail"]


@pytest.fixture(params=LOCAL + GLOBAL)
def descriptor(request):
    return registry.build("descriptors", request.param)


def speckle(seed):
    noise = np.random.default_rng(seed).integers(0, 256, (60, 80)).astype(np.uint8)
    return cv2.resize(noise, (320, 240), interpolation=cv2.INTER_CUBIC)


def test_contract(descriptor):
    assert isinstance(descriptor, ports.Descriptor)
    found = descriptor.describe(FRAME, speckle(0))
    assert found.ndim == 2
    assert len(found) > 0
    assert descriptor.comparison in ("bag", "cosine", "l1", "equal")
    if descriptor.comparison != "bag":
        assert len(found) == 1
    np.testing.assert_array_equal(found, descriptor.describe(FRAME, speckle(0)))


def test_nothing_seen_gives_no_descriptors(descriptor):
    blind = DepthFrame(0.0, np.zeros_like(FRAME.depth), CAMERA)
    nothing = descriptor.describe(blind, np.zeros((240, 320), np.uint8))
    n_values = descriptor.describe(FRAME, speckle(0)).shape[1]
    assert nothing.shape == (0 if descriptor.comparison == "bag" else 1, n_values)
    assert np.isfinite(nothing).all()


def test_gray_is_asked_for_where_it_is_needed(descriptor):
    if descriptor.needs_gray:
        with pytest.raises(ValueError, match="a grey image is needed, got none"):
            descriptor.describe(FRAME, None)
    else:
        assert len(descriptor.describe(FRAME, None)) > 0


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


def grating(angle_rad, cycles):
    y, x = np.mgrid[:240, :320]
    along = np.cos(angle_rad) * x / 320 + np.sin(angle_rad) * y / 240
    return (127 + 100 * np.sin(2 * np.pi * cycles * along)).astype(np.uint8)


def test_gist_has_the_most_energy_at_the_grating_s_scale_and_orientation():
    gist = registry.build("descriptors", "gist")

    def strongest(image):
        energy = gist.describe(FRAME, image).reshape(4, 8, 16).mean(axis=2)
        return np.unravel_index(energy.argmax(), energy.shape)

    scale, orientation = strongest(grating(0.0, 20))
    assert strongest(grating(np.pi / 2, 20)) == (scale, (orientation + 4) % 8)
    assert strongest(grating(0.0, 6)) > (scale, 7)  # a coarser filter


def test_gist_looks_at_structure_and_not_at_brightness():
    gist = registry.build("descriptors", "gist")
    image, other = 20 + speckle(2) // 4, 20 + speckle(3) // 4
    one, brighter, another = (gist.describe(FRAME, i) for i in (image, 3 * image, other))
    assert np.abs(one - brighter).mean() < 0.5 * np.abs(one - another).mean()
