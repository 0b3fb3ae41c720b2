import numpy as np
import pytest

from slam_bof.evaluation import pose_accuracy
from slam_bof.evaluation.localization_metrics import align_poses
from slam_bof.geometry import se3


@pytest.fixture
def poses():
    """Twenty poses in a map, and the same in a world that it lies askew in."""
    random = np.random.default_rng(0)
    T_map_camera = se3.exp(random.normal(size=(20, 6)))
    T_world_map = se3.exp(np.array([0.3, -0.2, 1.0, 2.0, 0.5, -1.0]))
    return T_map_camera, T_world_map @ T_map_camera, T_world_map


def test_exact_answers_are_within_every_limit(poses):
    found, truth, T_world_map = poses
    np.testing.assert_allclose(align_poses(found, truth), T_world_map, atol=1e-12)
    accuracy = pose_accuracy(found, truth)
    assert (accuracy.n, accuracy.n_known) == (20, 20)
    assert set(accuracy.within.values()) == {1.0}
    assert accuracy.median_m < 1e-12


def test_wrong_answers_do_not_bend_the_others(poses):
    found, truth, _ = poses
    found, truth = found.copy(), truth.copy()
    found[:8, :3, 3] += [3.0, 0.0, 0.0]
    found[8] = np.nan
    truth[9] = np.nan
    accuracy = pose_accuracy(found, truth)
    assert (accuracy.n, accuracy.n_known) == (19, 18)
    assert accuracy.within[0.05, 5.0] == pytest.approx(10 / 18)


def test_nothing_known_cannot_be_judged(poses):
    found, truth, _ = poses
    assert pose_accuracy(np.full_like(found, np.nan), truth) is None
