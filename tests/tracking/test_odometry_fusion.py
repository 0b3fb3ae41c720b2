"""Odometry and alignment are weighed by what each errs by, whatever that is."""

import json

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.tracking.odometry_fusion import OdometryFusion

N = 400
KEPT = 7
"""Frames from one keyframe to the next."""
FROM = 100
"""By then the noise is known."""


def noise(n, mm, seed):
    """Small motions (n, 4, 4), of as many mrad as mm on each axis."""
    return se3.exp(np.random.default_rng(seed).normal(0.0, 1e-3 * mm, (n, 6)))


@pytest.fixture(scope="module")
def truth():
    """A camera carried about: (N, 4, 4)."""
    t = np.arange(N)[:, None] / 30.0
    sway = np.sin(t * [0.7, 1.1, 0.9, 0.8, 0.6, 1.3]) * [0.2, 0.4, 0.1, 0.5, 0.1, 0.4]
    return se3.exp(sway)


def fused(odometry, aligned):
    fusion = OdometryFusion()
    fusion.restart(odometry[0], aligned[0])
    poses = [aligned[0]]
    for i in range(1, len(odometry)):
        if i % KEPT == 0:
            fusion.change_reference()
        poses.append(fusion.fuse(odometry[i], aligned[i]))
    return np.array(poses)


def off_mm(poses, truth):
    """By how many mm, root mean square over the axes, poses are off once the noise is known."""
    T = (se3.inverse(truth) @ poses)[FROM:]
    return 1e3 * np.sqrt(np.mean(T[:, :3, 3] ** 2))


def drifting(truth, mm, seed=5):
    steps = se3.inverse(truth[:-1]) @ truth[1:] @ noise(len(truth) - 1, mm, seed)
    poses = [truth[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def test_exact_odometry_keeps_its_steps(truth):
    aligned = truth @ noise(N, 3.0, 0)
    poses = fused(se3.exp(np.full(6, 0.1)) @ truth, aligned)
    assert off_mm(aligned, truth) > 2.7
    assert off_mm(poses, truth) < 2.0


def test_exact_alignment_is_taken(truth):
    for odometry in (drifting(truth, 10.0), truth @ noise(N, 10.0, 1)):
        aligned = truth @ noise(N, 0.5, 2)
        assert off_mm(fused(odometry, aligned), truth) < 1.5 * off_mm(aligned, truth)


@pytest.mark.parametrize(("drift_mm", "jitter_mm"), [(1.0, 1.0), (0.3, 3.0), (3.0, 3.0), (6.0, 0)])
def test_both_together_are_better_than_either(truth, drift_mm, jitter_mm):
    odometry = drifting(truth, drift_mm) @ noise(N, jitter_mm, 1)
    aligned = truth @ noise(N, 3.0, 2)
    poses = fused(odometry, aligned)
    assert off_mm(poses, truth) < off_mm(aligned, truth)
    assert off_mm(poses, truth) < off_mm(odometry, truth)


def test_drift_does_not_add_up(truth):
    """Steady drift, which no noise model foresees."""
    odometry = truth @ se3.exp(np.outer(np.arange(N), [0, 1e-3, 0, 2e-3, 0, 0]))
    aligned = truth @ noise(N, 3.0, 2)
    assert off_mm(odometry, truth) > 200
    assert off_mm(fused(odometry, aligned), truth) < 6.0


def test_a_slip_is_mended_at_once(truth):
    odometry = truth.copy()
    odometry[200:] = odometry[200:] @ se3.exp(np.array([0, 0.05, 0, 0.1, 0, 0]))
    poses = fused(odometry, truth @ noise(N, 3.0, 3))
    assert 1e3 * np.abs((se3.inverse(truth) @ poses)[200:205, :3, 3]).max() < 12.0


def fused_where_each_is_a_keyframe(odometry, aligned_steps):
    """Fuse poses where each frame is aligned with the one before."""
    fusion = OdometryFusion()
    poses = [odometry[0]]
    fusion.restart(odometry[0], odometry[0])
    for i in range(1, len(odometry)):
        fusion.change_reference()
        poses.append(fusion.fuse(odometry[i], poses[-1] @ aligned_steps[i - 1]))
    return np.array(poses), fusion


def step_errors_mm(poses, truth):
    """By how many mm, root mean square, steps are off once the noise is known."""
    steps, true_steps = (se3.inverse(T[FROM:-1]) @ T[FROM + 1 :] for T in (poses, truth))
    return 1e3 * np.sqrt(np.mean((se3.inverse(true_steps) @ steps)[:, :3, 3] ** 2))


@pytest.fixture(scope="module")
def sparse(truth):
    """The camera at a tenth of its rate, (N, 4, 4)."""
    return se3.exp(10.0 * se3.log(truth))


@pytest.mark.parametrize("odometry_mm", [0.0, 5.0, 50.0])
def test_where_each_frame_is_a_keyframe_the_more_precise_step_counts(sparse, odometry_mm):
    odometry = drifting(sparse, odometry_mm)
    steps = se3.inverse(sparse[:-1]) @ sparse[1:] @ noise(N - 1, 50.0, 2)
    poses, _ = fused_where_each_is_a_keyframe(odometry, steps)
    assert step_errors_mm(poses, sparse) < (15.0 if odometry_mm < 50.0 else 45.0)


def test_odometry_that_stays_behind_is_not_taken(sparse):
    """Its steps are the steadier ones, but what they lack is in the next step too."""
    steps = se3.inverse(sparse[:-1]) @ sparse[1:]
    behind = [sparse[0]]
    for half in se3.exp(0.5 * se3.log(steps)):
        behind.append(behind[-1] @ half)
    poses, _ = fused_where_each_is_a_keyframe(np.array(behind), steps @ noise(N - 1, 5.0, 2))
    assert step_errors_mm(poses, sparse) < 6.0


def test_what_is_known_of_steps_survives_saving(sparse):
    steps = se3.inverse(sparse[:-1]) @ sparse[1:] @ noise(N - 1, 50.0, 2)
    _, fusion = fused_where_each_is_a_keyframe(sparse[:50], steps)
    restored = OdometryFusion()
    restored.restore(json.loads(json.dumps(fusion.state())))
    fusion.change_reference()
    next_poses = sparse[50], sparse[49] @ steps[49]
    np.testing.assert_array_equal(restored.fuse(*next_poses), fusion.fuse(*next_poses))


def test_a_restart_is_where_it_is_said_to_be(truth):
    fusion = OdometryFusion()
    fusion.restart(truth[10], truth[3])
    np.testing.assert_allclose(fusion.predict(truth[10]), truth[3], atol=1e-12)
    step = se3.inverse(truth[10]) @ truth[11]
    np.testing.assert_allclose(fusion.predict(truth[11]), truth[3] @ step, atol=1e-12)


def test_poses_of_few_digits_stay_poses(truth):
    poses = fused(truth.round(3), (truth @ noise(N, 1.0, 4)).round(3))
    R = poses[:, :3, :3]
    assert np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max() < 5e-3
    assert off_mm(poses, truth) < 2.0
