"""Odometry is corrected by what the surfaces hold, and by no more than it errs."""

import json

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.tracking.odometry_fusion import OdometryFusion

N = 300
KEPT = 5
"""Frames from one keyframe to the next."""
SIGMA = np.repeat([0.001, 0.003], 3)
"""Of an alignment: rad, m."""


def information(open_axes=()):
    sigma = SIGMA.copy()
    sigma[list(open_axes)] = 1e3
    return np.diag(1.0 / np.square(sigma))


@pytest.fixture(scope="module")
def truth():
    """A camera carried straight on, swaying: (N, 4, 4)."""
    t = np.arange(N)[:, None] / 30.0
    sway = np.sin(t * [0.7, 1.1, 0.9, 0.8, 0.6, 1.3]) * [0.05, 0.1, 0.05, 0.1, 0.05, 0.05]
    poses = se3.exp(sway)
    poses[:, 2, 3] += 0.5 * t[:, 0]
    return poses


def long(truth, share):
    """Odometry whose steps are too long by a share."""
    steps = se3.inverse(truth[:-1]) @ truth[1:]
    steps[:, :3, 3] *= 1.0 + share
    poses = [truth[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def fused(odometry, truth, *, open_axes=(), covariance=None, restored_at=None, seed=0):
    """Track as the tracker does: align with the last keyframe, with noise, where it is held."""
    rng = np.random.default_rng(seed)
    fusion = OdometryFusion()
    fusion.restart(odometry[0], truth[0])
    fusion.change_reference()
    poses, keyframe = [truth[0]], 0
    for k in range(1, len(odometry)):
        T_guess = fusion.predict(odometry[k], covariance)
        T_aligned = poses[keyframe] @ se3.inverse(truth[keyframe]) @ truth[k]
        T_aligned = T_aligned @ se3.exp(SIGMA * rng.standard_normal(6))
        off = se3.log(se3.inverse(T_guess) @ T_aligned)
        off[list(open_axes)] = 0.0  # there an alignment stays where it started
        poses.append(fusion.fuse(T_guess @ se3.exp(off), information(open_axes)))
        if k % KEPT == 0:
            fusion.change_reference()
            keyframe = k
            if k == restored_at:
                state = json.loads(json.dumps(fusion.state()))
                fusion = OdometryFusion()
                fusion.restore(state)
    return np.array(poses), fusion


def off_m(poses, truth):
    """How far off the last pose is, along x, y and z of the camera."""
    return (se3.inverse(truth[-1]) @ poses[-1])[:3, 3]


def test_exact_odometry_stays_exact(truth):
    poses, _ = fused(truth, truth)
    assert np.linalg.norm((se3.inverse(truth) @ poses)[:, :3, 3], axis=1).max() < 0.025


def test_drift_is_corrected_where_the_surfaces_hold(truth):
    odometry = long(truth, 0.1)
    poses, fusion = fused(odometry, truth)
    assert np.linalg.norm(off_m(odometry, truth)) > 0.3
    assert np.linalg.norm(off_m(poses, truth)) < 0.05
    assert fusion.drift[5] > 0.03


def test_drift_along_an_open_direction_stays_and_moves_no_other(truth):
    odometry = long(truth, 0.1)
    poses, _ = fused(odometry, truth, open_axes=[5])
    assert off_m(poses, truth)[2] == pytest.approx(off_m(odometry, truth)[2], abs=0.05)
    assert np.abs(off_m(poses, truth)[:2]).max() < 0.1


def test_a_covariance_that_is_given_decides(truth):
    odometry = long(truth, 0.1)
    sure, _ = fused(odometry, truth, covariance=1e-14 * np.eye(6))
    unsure, _ = fused(odometry, truth, covariance=1e-2 * np.eye(6))
    assert np.abs(sure - odometry).max() < 1e-3
    assert np.linalg.norm(off_m(unsure, truth)) < 0.05


def test_a_slip_is_corrected_at_once(truth):
    odometry = truth.copy()
    odometry[100:] = (
        truth[99]
        @ se3.exp([0.0, 0.05, 0.0, 0.2, 0.0, 0.1])
        @ (se3.inverse(truth[99]) @ truth[100:])
    )
    poses, _ = fused(odometry, truth)
    assert np.linalg.norm((se3.inverse(truth) @ poses)[:, :3, 3], axis=1).max() < 0.05


def test_the_covariance_grows_with_the_way_and_starts_anew_at_a_keyframe(truth):
    fusion = OdometryFusion()
    fusion.restart(truth[0], truth[0])
    sizes = []
    for T in truth[1:20]:
        fusion.predict(T)
        sizes.append(np.trace(fusion.covariance))
    assert (np.diff(sizes) > 0).all()
    fusion.change_reference()
    assert not fusion.covariance.any()


def test_what_was_saved_goes_on_the_same(truth):
    odometry = long(truth, 0.03)
    np.testing.assert_array_equal(
        fused(odometry, truth, restored_at=150)[0], fused(odometry, truth)[0]
    )
