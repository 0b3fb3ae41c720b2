import numpy as np
import pytest

from slam_bof.synthetic import SensorModelParams, sense
from slam_bof.types import INVALID_DEPTH_MM

SHAPE = (240, 320)
BRIGHT = np.ones(SHAPE, np.float32)
CLEAN = SensorModelParams(speckle_loss=0, border_px=0)


def wall(z):
    return np.full(SHAPE, z, np.float32)


def valid(depth):
    return depth[(depth > 0) & (depth < INVALID_DEPTH_MM)] / 1000.0


@pytest.mark.parametrize("z", [0.8, 1.5, 2.5, 4.0])
def test_noise_is_the_published_deviation_and_no_bias(z):
    slope = np.linspace(0.96, 1.04, SHAPE[1], dtype=np.float32)
    true = wall(z) * slope
    error = sense(true, BRIGHT, np.random.default_rng(0), CLEAN) / 1000.0 - true
    sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
    assert error.std() == pytest.approx(sigma, rel=0.1)
    assert error.mean() == pytest.approx(0.0, abs=0.1 * sigma)


def test_steps_grow_with_the_square_of_depth():
    def step(z):
        ramp = BRIGHT * np.linspace(z - 0.1, z + 0.1, SHAPE[1], dtype=np.float32)
        levels = np.unique(valid(sense(ramp, BRIGHT, np.random.default_rng(0), CLEAN)))
        return np.diff(levels).mean()

    assert step(3.0) / step(1.5) == pytest.approx(4.0, rel=0.1)
    assert step(2.0) == pytest.approx(2.0**2 * 0.125 / (585 * 0.075), rel=0.1)


def test_out_of_range_and_nothing_are_65535():
    depth = wall(2.0)
    depth[:, :40], depth[:, 40:80], depth[:, 80:120] = 0.2, 6.0, 0.0
    out = sense(depth, BRIGHT, np.random.default_rng(0), CLEAN.model_copy(update={"lateral_px": 0}))
    assert set(np.unique(out[:, :120])) <= {0, INVALID_DEPTH_MM}
    assert (out[:, 85:115] == INVALID_DEPTH_MM).all()
    assert (np.abs(out[:, 130:].astype(int) - 2000) < 60).mean() > 0.99


def test_the_shadow_falls_left_of_a_near_thing_as_wide_as_the_disparity_says():
    depth = wall(3.0)
    depth[:, 150:200] = 1.0
    still = CLEAN.model_copy(update={"lateral_px": 0, "edge_loss": 0})
    lost = (sense(depth, BRIGHT, np.random.default_rng(0), still) == 0)[100]
    width = 585 * 0.075 * (1 / 1.0 - 1 / 3.0)
    assert lost.sum() == pytest.approx(width, abs=1.5)
    assert np.flatnonzero(lost).max() == 149


def test_weak_returns_are_lost_and_strong_ones_are_not():
    rng = np.random.default_rng(0)
    lost = [
        (sense(wall(1.5), share * BRIGHT, rng, CLEAN) == 0).mean() for share in (0.02, 0.15, 0.5)
    ]
    assert lost[0] > 0.9
    assert 0.3 < lost[1] < 0.7
    assert lost[2] == 0


def test_edges_lose_pixels_and_their_border_wanders():
    depth = wall(2.0)
    depth[:, 160:] = 2.2
    out = sense(depth, BRIGHT, np.random.default_rng(0), CLEAN)
    assert 0.1 < (out[:, 159:161] == 0).mean() < 0.8
    swapped = out[:, 160]
    assert ((swapped > 1900) & (swapped < 2100)).any()


def test_the_border_is_blind_and_the_seed_decides():
    depth = wall(1.5)
    first = sense(depth, BRIGHT, np.random.default_rng(5))
    assert first.dtype == np.uint16
    assert not first[:, -8:].any()
    np.testing.assert_array_equal(first, sense(depth, BRIGHT, np.random.default_rng(5)))
    assert (first != sense(depth, BRIGHT, np.random.default_rng(6))).any()
