import cv2
import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof import ports, registry
from slam_bof.places import PlaceParams, descriptors
from slam_bof.types import DepthFrame

FRAME = DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)


@pytest.fixture(params=["bof", "orb", "sift"])
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
    assert found.dtype == (np.uint8 if descriptor.is_binary else np.float32)
    np.testing.assert_array_equal(found, descriptor.describe(FRAME, speckle(0)))


def test_nothing_seen_gives_no_descriptors(descriptor):
    blind = DepthFrame(0.0, np.zeros_like(FRAME.depth), CAMERA)
    nothing = descriptor.describe(blind, np.zeros((240, 320), np.uint8))
    assert nothing.shape == (0, descriptor.describe(FRAME, speckle(0)).shape[1])


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
