import numpy as np
import pytest

from slam_bof.scenes import SceneFilter, SceneFilterParams
from slam_bof.scenes.hmm_smoother import smooth
from slam_bof.scenes.view_novelty import novelties, pooled
from slam_bof.types import Scene

CLASSES = ("bath", "kitchen", "office")
PARAMS = SceneFilterParams()
UNSURE = Scene("bath", 0.5, CLASSES, np.array([0.5, 0.3, 0.2]))


def test_a_view_is_new_by_how_far_it_stands_and_turns():
    turn = np.radians([0.0, 0.0, 30.0, 60.0, 180.0])
    axes = np.stack([np.sin(turn), np.zeros(5), np.cos(turn)], axis=1)
    positions_m = np.zeros((5, 3))
    found = novelties(positions_m, axes, np.zeros(5))
    assert found[0] == 1.0
    assert found[1] == pytest.approx(0.0, abs=1e-6)
    assert found[2] == pytest.approx(1 - np.exp(-1.0))
    assert found[2] == pytest.approx(found[3])  # 30 degrees from the one before
    assert found[4] > 0.98
    apart_m = np.outer([0.0, 1.0, 3.0], [0.0, 0.0, 1.0])
    ahead = np.tile([0.0, 0.0, 1.0], (3, 1))
    assert novelties(apart_m, ahead, np.zeros(3))[1:] == pytest.approx(
        [1 - np.exp(-1.0), 1 - np.exp(-2.0)]
    )
    assert novelties(apart_m, ahead, np.arange(3)).tolist() == [1.0] * 3
    apart_m[1] = np.nan
    assert novelties(apart_m, ahead, np.zeros(3))[1:] == pytest.approx([0.1, 1 - np.exp(-3.0)])
    assert novelties(apart_m * np.nan, ahead, np.zeros(3)).tolist() == [0.1] * 3


@pytest.mark.parametrize("n", [30, 300])
def test_repetition_makes_no_certainty(n):
    """A wrong view of one wall, again and again, is no certain label; different views make one."""
    stamps_s, turn = 0.5 * np.arange(n), np.linspace(0.0, 2.0 * np.pi, n)
    places_m = {"rest": np.zeros((n, 3)), "walk": np.outer(np.linspace(0, 8, n), [1.0, 0, 0])}
    axes = {
        "rest": np.tile([0.0, 0.0, 1.0], (n, 1)),
        "walk": np.stack([np.sin(turn), np.zeros(n), np.cos(turn)], axis=1),
    }
    smoothed, live = {}, {}
    for how, positions_m in places_m.items():
        found = smooth([UNSURE] * n, stamps_s, positions_m, PARAMS, axes=axes[how])
        smoothed[how] = max(scene.probability for scene in found)
        filter_ = SceneFilter(PARAMS)
        rows = zip(stamps_s, positions_m, axes[how], strict=True)
        live[how] = max(filter_.update(UNSURE, t, x, axis=a).probability for t, x, a in rows)
    for found in (smoothed, live):
        assert found["rest"] == pytest.approx(0.5, abs=0.01)  # as certain as one view
        assert found["walk"] > found["rest"]


@pytest.mark.parametrize(
    ("n_new", "n_independent"), [(0.3, 1.0), (1.0, 1.0), (3.5, 1.75), (1e9, 2.5)]
)
def test_views_count_as_a_cluster_sample(n_new, n_independent):
    """Views that are all the same, by 2:1, make the scene as likely as so many independent ones."""
    logs = 40.0 * np.log([2.0, 1.0])
    p = pooled(logs, np.array(n_new), np.array(40.0), 0.4)
    assert p[0] / p[1] == pytest.approx(2.0**n_independent)


def test_an_odometry_that_leaps_makes_no_certainty():
    """Each view stands far from the one before, as if all were of different places."""
    axes, positions_m = np.tile([0.0, 0.0, 1.0], (30, 1)), np.outer(np.arange(30), [0.4, 0.0, 0.0])
    found = smooth([UNSURE] * 30, 0.1 * np.arange(30), positions_m, PARAMS, axes=axes)
    most = UNSURE.probabilities ** (1.0 / PARAMS.view_correlation)
    assert max(scene.probability for scene in found) < most[0] / most.sum()


def test_a_new_segment_of_odometry_has_seen_nothing():
    def last(segment: int) -> float:
        filter_ = SceneFilter(PARAMS)
        for k in range(20):
            filter_.update(UNSURE, 0.1 * k, (0, 0, 0), axis=(0.0, 0.0, 1.0))
        arguments = UNSURE, 2.0, (0, 0, 0)
        return filter_.update(*arguments, axis=(0.0, 0.0, 1.0), segment=segment).probability

    assert last(1) > last(0)
