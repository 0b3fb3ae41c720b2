import cv2
import numpy as np
import oracle
import pytest
from hypothesis import given, settings, strategies as st

from slam_bof.bof import (
    ContourParams,
    LayerParams,
    PlaceDescriber,
    PlaceParams,
    TfIdf,
    Vocabulary,
    count_words,
    descriptors,
)
from slam_bof.geometry import PointParams, points_camera_f32
from slam_bof.types import DepthFrame, Intrinsics

CAMERA = Intrinsics(width=32, height=24, fx=30.0, fy=30.0, cx=15.5, cy=11.5)
SMALL = PlaceParams(
    points=PointParams(stride=1),
    layers=LayerParams(n_layers=3, resolution_px=24),
    contours=ContourParams(closing_px=3),
)


def random_frame(seed, camera=CAMERA):
    """Return a wall with boxes before it, with holes."""
    rng = np.random.default_rng(seed)
    depth = np.full((camera.height, camera.width), 3000.0)
    for _ in range(4):
        row, column = rng.integers(0, camera.height), rng.integers(0, camera.width)
        depth[row : row + 10, column : column + 12] = rng.uniform(800, 2800)
    depth += rng.normal(0, 5, depth.shape)
    depth[rng.random(depth.shape) < 0.05] = 0
    return DepthFrame(0.0, depth.astype(np.uint16), camera)


def oracle_descriptors(frame, params):
    # The chain computes in single precision; from the same points all else must be equal.
    points = points_camera_f32(frame, params.points)
    layers, contours = params.layers, params.contours
    images = oracle.layer_images(points, layers.n_layers, layers.rounding, layers.resolution_px)
    found = oracle.find_contours(images, contours.closing_px, contours.min_area_share)
    return np.array([oracle.bof(contour, params.bof.n_points) for _, contour in found])


@given(st.integers(0, 1000), st.sampled_from(["floor", "nearest"]))
@settings(max_examples=20)
def test_descriptors_equal_the_oracle(seed, rounding):
    frame = random_frame(seed)
    layers = SMALL.layers.model_copy(update={"rounding": rounding})
    params = SMALL.model_copy(update={"layers": layers})
    found = descriptors(frame, params)
    assert len(found) > 0
    np.testing.assert_allclose(found, oracle_descriptors(frame, params), atol=1e-5)


def test_descriptors_of_a_real_frame_equal_the_oracle(shared_data):
    file = shared_data / "7scenes/redkitchen/seq-01/frame-000000.depth.png"
    if not file.is_file():
        pytest.skip(f"{file} is not there")
    depth = cv2.imread(str(file), cv2.IMREAD_UNCHANGED)
    frame = DepthFrame(0.0, depth, Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0))
    params = PlaceParams(
        points=PointParams(stride=8), layers=LayerParams(n_layers=5, resolution_px=60)
    )
    found = descriptors(frame, params)
    np.testing.assert_allclose(found, oracle_descriptors(frame, params), atol=1e-5)


@pytest.fixture(scope="module")
def describer():
    frames = [descriptors(random_frame(seed), SMALL) for seed in range(30)]
    vocabulary = Vocabulary(n_words=16).fit(np.concatenate(frames))
    words = [vocabulary.lookup(frame) for frame in frames]
    return PlaceDescriber(SMALL, vocabulary, TfIdf().fit(count_words(words, 16)))


def test_a_frame_becomes_a_bag(describer):
    frame = random_frame(99)
    found = descriptors(frame, SMALL)
    assert found.shape[1] == 180
    words = describer.words(frame)
    assert words.shape == (len(found),)
    bag = describer.describe(frame)
    assert bag.weights.sum() == pytest.approx(1.0, abs=1e-6)
    assert set(bag.words.tolist()) <= set(words.tolist())


def test_layers_along_gravity_need_to_know_it():
    params = SMALL.model_copy(update={"layers": LayerParams(n_layers=3, axis="gravity")})
    frame = random_frame(7)
    with pytest.raises(ValueError, match="layers along gravity need gravity_camera"):
        descriptors(frame, params)
    down = np.array([0.0, 0.0, 1.0])  # a camera that looks at the floor
    along_optical_axis = SMALL.model_copy(update={"layers": LayerParams(n_layers=3)})
    np.testing.assert_array_equal(
        descriptors(frame, params, gravity_camera=down), descriptors(frame, along_optical_axis)
    )


def test_millimetres_and_metres_give_the_same_bag(describer):
    frame = random_frame(5)
    metres = DepthFrame(0.0, frame.depth * np.float32(0.001), CAMERA)
    assert describer.describe(metres).words.tolist() == describer.describe(frame).words.tolist()


def test_a_blind_frame_has_an_empty_bag(describer):
    blind = DepthFrame(0.0, np.zeros((24, 32), np.uint16), CAMERA)
    assert descriptors(blind, SMALL).shape == (0, 180)
    assert describer.words(blind).shape == (0,)
    bag = describer.describe(blind)
    assert bag.words.shape == bag.weights.shape == (0,)
