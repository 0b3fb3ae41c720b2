import platform

import numpy as np
import pytest
from kiss_icp.config import KISSConfig
from kiss_icp.threshold import get_threshold_estimator

from slam_bof.geometry import se3
from slam_bof_plugins.adaptive_threshold import AdaptiveThreshold

INITIAL_M, MIN_MOTION_M, MAX_RANGE_M = 0.1, 0.015, 5.0


def of_the_library():
    config = KISSConfig()
    config.adaptive_threshold.initial_threshold = INITIAL_M
    config.adaptive_threshold.min_motion_th = MIN_MOTION_M
    config.data.max_range = MAX_RANGE_M
    return get_threshold_estimator(config)


def deviations(n, sigma, seed=0):
    rng = np.random.default_rng(seed)
    return [se3.exp(rng.normal(0.0, sigma, 6)) for _ in range(n)]


@pytest.mark.parametrize("sigma", [1e-4, 0.003, 0.02, 0.3, 2.0])
def test_it_agrees_with_the_library(sigma):
    own, other = AdaptiveThreshold(INITIAL_M, MIN_MOTION_M, MAX_RANGE_M), of_the_library()
    is_exact = sigma < 1.0 and platform.machine() == "x86_64"
    for deviation in deviations(300, sigma):
        own.update_model_deviation(deviation)
        other.update_model_deviation(deviation)
        found, expected = own.get_threshold(), other.get_threshold()
        assert found == (expected if is_exact else pytest.approx(expected, rel=1e-12))


def test_small_deviations_do_not_count():
    threshold = AdaptiveThreshold(INITIAL_M, MIN_MOTION_M, MAX_RANGE_M)
    threshold.update_model_deviation(se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, MIN_MOTION_M])))
    assert threshold.get_threshold() == INITIAL_M
    threshold.update_model_deviation(se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.3, 0.4])))
    assert threshold.get_threshold() == pytest.approx(np.sqrt((0.01 + 0.25) / 2))


@pytest.mark.parametrize("state", [(1.0, 0.0), (-1.0, 2.0), (np.nan, 2.0), (1.0, 2.5)])
def test_what_is_no_state_is_refused(state):
    with pytest.raises(ValueError, match="found"):
        AdaptiveThreshold(INITIAL_M, MIN_MOTION_M, MAX_RANGE_M).restore(np.array(state))
