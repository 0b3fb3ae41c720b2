"""Odometry and alignment are weighed along each direction by what each errs by."""

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
ISOTROPIC = np.ones(6)


def noise(n, mm, seed):
    """Small motions (n, 4, 4), of as many mrad as mm, on each axis or by axes (6,)."""
    return se3.exp(np.random.default_rng(seed).standard_normal((n, 6)) * 1e-3 * mm)


def information(mm):
    """What the points tell of an alignment that errs by as many mrad and mm."""
    return np.diag((1e-3 * mm * ISOTROPIC) ** -2)


@pytest.fixture(scope="module")
def truth():
    """A camera carried about: (N, 4, 4)."""
    t = np.arange(N)[:, None] / 30.0
    sway = np.sin(t * [0.7, 1.1, 0.9, 0.8, 0.6, 1.3]) * [0.2, 0.4, 0.1, 0.5, 0.1, 0.4]
    return se3.exp(sway)


@pytest.fixture(scope="module")
def sparse(truth):
    """The camera at a tenth of its rate, (N, 4, 4)."""
    return se3.exp(10.0 * se3.log(truth))


def drifting(truth, mm, seed=5):
    steps = se3.inverse(truth[:-1]) @ truth[1:] @ noise(len(truth) - 1, mm, seed)
    poses = [truth[0]]
    for step in steps:
        poses.append(poses[-1] @ step)
    return np.array(poses)


def fused(truth, odometry, errors, told_mm, kept=KEPT, fusion=None):
    """Return poses (N, 4, 4) of frames aligned with the last keyframe, but for errors (N, 4, 4)."""
    fusion = fusion or OdometryFusion()
    fusion.restart(odometry[0], truth[0])
    fusion.change_keyframe()
    poses, keyframe = [truth[0]], 0
    for i in range(1, len(odometry)):
        aligned = poses[keyframe] @ se3.inverse(truth[keyframe]) @ truth[i] @ errors[i]
        poses.append(fusion.fuse(odometry[i], aligned, information(told_mm)))
        if i % kept == 0:
            keyframe = i
            fusion.change_keyframe()
    return np.array(poses)


def off_mm(poses, truth, kept=KEPT):
    """By how many mm, root mean square, frames are off from their keyframe on each axis, (3,)."""
    i = np.arange(FROM, len(poses))
    k = (i - 1) // kept * kept
    steps, true_steps = (se3.inverse(T[k]) @ T[i] for T in (poses, truth))
    off = (se3.inverse(true_steps) @ steps)[:, :3, 3]
    return 1e3 * np.sqrt(np.mean(off**2, axis=0))


def test_exact_odometry_keeps_its_steps(truth):
    poses = fused(truth, se3.exp(np.full(6, 0.1)) @ truth, noise(N, 3.0, 0), 3.0)
    assert (off_mm(poses, truth) < 0.5).all()


def test_exact_alignment_is_taken(truth):
    for odometry in (drifting(truth, 10.0), truth @ noise(N, 10.0, 1)):
        poses = fused(truth, odometry, noise(N, 0.5, 2), 0.5)
        assert (off_mm(poses, truth) < 0.7).all()


@pytest.mark.parametrize(
    ("drift_mm", "jitter_mm"), [(1.0, 1.0), (0.3, 3.0), (3.0, 3.0), (6.0, 0.0), (0.3, 0.3)]
)
def test_both_together_are_about_as_good_as_the_better_one(truth, drift_mm, jitter_mm):
    odometry = drifting(truth, drift_mm) @ noise(N, jitter_mm, 1)
    by_both = off_mm(fused(truth, odometry, noise(N, 3.0, 2), 3.0), truth).mean()
    assert by_both < 1.5 * min(3.0, off_mm(odometry, truth).mean())


def test_a_direction_that_is_weakly_held_is_left_to_exact_odometry(truth):
    """Odometry slides sideways (x), where alignment holds; ahead (z) alignment is poor."""
    told_mm = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 30.0])
    sliding = se3.inverse(truth[:-1]) @ truth[1:]
    sliding = sliding @ se3.exp(np.array([0.0, 0.0, 0.0, 0.01, 0.0, 0.0]))
    odometry = [truth[0]]
    for step in sliding:
        odometry.append(odometry[-1] @ step)
    poses = fused(truth, np.array(odometry), noise(N, told_mm, 3), told_mm)
    aside, _, ahead = off_mm(poses, truth)
    assert aside < 2.0
    assert ahead < 6.0


def test_drift_does_not_add_up_within_a_keyframe(truth):
    """Steady drift, which no noise model foresees."""
    odometry = truth @ se3.exp(np.outer(np.arange(N), [0, 1e-2, 0, 2e-2, 0, 0]))
    poses = fused(truth, odometry, noise(N, 3.0, 2), 3.0)
    assert off_mm(odometry, truth).max() > 50.0
    assert off_mm(poses, truth).max() < 4.0


def test_a_slip_is_mended_at_once(truth):
    odometry = truth.copy()
    odometry[200:] = odometry[200:] @ se3.exp(np.array([0, 0.05, 0, 0.1, 0, 0]))
    poses = fused(truth, odometry, noise(N, 3.0, 3), 3.0)
    off = se3.inverse(se3.inverse(truth[196]) @ truth[200:203]) @ se3.inverse(poses[196])
    assert 1e3 * np.abs((off @ poses[200:203])[:, :3, 3]).max() < 12.0


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_exact_odometry_shows_that_alignment_errs_by_more_than_its_points_tell(truth, factor):
    poses = fused(truth, truth, noise(N, 3.0 * factor, 0), 3.0)
    assert (off_mm(poses, truth) < 0.2 * 3.0 * factor).all()


@pytest.mark.parametrize("odometry_mm", [0.0, 5.0, 200.0])
def test_where_each_frame_is_a_keyframe_the_more_precise_step_counts(sparse, odometry_mm):
    poses = fused(sparse, drifting(sparse, odometry_mm), noise(N, 50.0, 2), 50.0, kept=1)
    assert off_mm(poses, sparse, kept=1).mean() < (15.0 if odometry_mm < 50.0 else 55.0)


def test_odometry_that_stays_behind_is_not_taken(sparse):
    """Its steps are the steadier ones."""
    behind = [sparse[0]]
    for half in se3.exp(0.5 * se3.log(se3.inverse(sparse[:-1]) @ sparse[1:])):
        behind.append(behind[-1] @ half)
    poses = fused(sparse, np.array(behind), noise(N, 5.0, 2), 5.0, kept=1)
    assert off_mm(poses, sparse, kept=1).mean() < 6.0


def test_a_known_covariance_is_weighed_as_by_a_kalman_filter(truth):
    fusion = OdometryFusion()
    fusion.restart(truth[0], truth[0])
    fusion.change_keyframe()
    step_covariance = np.diag([1e-6, 2e-6, 3e-6, 4e-6, 5e-6, 6e-6])
    off = se3.exp(np.array([1e-4, 0.0, 0.0, 1e-4, 1e-4, 0.0]))
    found = fusion.fuse(truth[1], truth[1] @ off, information(2.0), step_covariance)
    gain = np.diag(step_covariance) / (np.diag(step_covariance) + 4e-6)
    np.testing.assert_allclose(
        se3.log(se3.inverse(truth[1]) @ found), gain * se3.log(off), atol=1e-9
    )
    posterior = np.diag((1.0 - gain) * np.diag(step_covariance))
    np.testing.assert_allclose(fusion.covariance, posterior, atol=1e-12)


def test_nothing_is_taken_along_open_directions(truth):
    fusion = OdometryFusion()
    fusion.restart(truth[0], truth[0])
    for held in (np.zeros(6), np.array([1.0, 1.0, 1.0, 0.0, 0.0, 1.0])):
        aligned = truth[0] @ se3.exp(np.full(6, 0.01))
        found = fusion.fuse(truth[0], aligned, 1e6 * np.diag(held))
        np.testing.assert_allclose(
            se3.log(se3.inverse(truth[0]) @ found)[held == 0.0], 0, atol=1e-4
        )


def test_what_is_known_survives_saving(sparse):
    fusion, restored = OdometryFusion(), OdometryFusion()
    fused(sparse[:50], drifting(sparse[:50], 60.0), noise(50, 50.0, 2), 50.0, kept=7, fusion=fusion)
    restored.restore(json.loads(json.dumps(fusion.state())))
    aligned = fusion.predict(sparse[50]) @ noise(1, 50.0, 4)[0]
    expected = fusion.fuse(sparse[50], aligned, information(50.0))
    np.testing.assert_array_equal(restored.fuse(sparse[50], aligned, information(50.0)), expected)


def test_a_state_of_earlier_versions_begins_to_learn_anew(truth):
    fusion = OdometryFusion()
    fusion.restore({"T_track_odometry": truth[3].tolist(), "n": 30, "difference": [1.0, 1.0]})
    np.testing.assert_allclose(fusion.predict(truth[5]), truth[3] @ truth[5])
    assert fusion.state()["n"] == 0


def test_a_restart_is_where_it_is_said_to_be(truth):
    fusion = OdometryFusion()
    fusion.restart(truth[10], truth[3])
    np.testing.assert_allclose(fusion.predict(truth[10]), truth[3], atol=1e-12)
    step = se3.inverse(truth[10]) @ truth[11]
    np.testing.assert_allclose(fusion.predict(truth[11]), truth[3] @ step, atol=1e-12)


def test_poses_of_few_digits_stay_poses(truth):
    poses = fused(truth, truth.round(3), noise(N, 1.0, 4), 1.0)
    R = poses[:, :3, :3]
    assert np.abs(R.transpose(0, 2, 1) @ R - np.eye(3)).max() < 5e-3
    assert (off_mm(poses, truth) < 2.0).all()


def test_what_is_known_of_alignment_holds_after_a_frame_without_one(sparse):
    fusion, errors = OdometryFusion(), noise(N, 50.0, 2)
    fused(sparse[:FROM], sparse[:FROM], errors, 5.0, kept=1, fusion=fusion)
    before = fusion.predict(sparse[FROM - 1])
    fusion.skip(sparse[FROM], None)
    fusion.change_keyframe()
    aligned = fusion.predict(sparse[FROM + 1]) @ se3.exp(np.full(6, 0.1))
    after = fusion.fuse(sparse[FROM + 1], aligned, information(5.0))
    step = se3.inverse(before) @ after
    off = se3.inverse(se3.inverse(sparse[FROM - 1]) @ sparse[FROM + 1]) @ step
    assert 1e3 * np.abs(off[:3, 3]).max() < 20.0


def test_a_frame_without_alignment_is_less_certain(truth):
    fusion = OdometryFusion()
    fused(truth, drifting(truth, 10.0), noise(N, 1.0, 2), 1.0, fusion=fusion)
    before = fusion.covariance
    fusion.skip(truth[-1], None)
    assert (np.diag(fusion.covariance - before) > (5e-3) ** 2).all()


def test_odometry_counts_as_exact_until_it_is_shown_not_to_be(truth):
    """An alignment that is off in the second frame does not move the track by much."""
    errors = np.tile(np.eye(4), (N, 1, 1))
    errors[2] = se3.exp(np.array([0.0, 0.0, 0.0, 0.015, 0.0, 0.0]))
    poses = fused(truth[:4], truth[:4], errors, 3.0)
    assert 1e3 * np.abs((se3.inverse(truth[:4]) @ poses)[:, :3, 3]).max() < 1.0


def test_a_state_of_before_steps_were_marked_is_restored(truth):
    fusion, restored = OdometryFusion(), OdometryFusion()
    fused(truth, drifting(truth, 3.0), noise(N, 3.0, 2), 3.0, fusion=fusion)
    state = fusion.state()
    older = {
        k: v for k, v in state.items() if k not in ("is_last_aligned", "skill", "step_covariance")
    }
    restored.restore(json.loads(json.dumps(older)))
    assert {k: restored.state()[k] for k in older} == older


def test_odometry_of_known_precision_is_not_led_away_by_a_wrong_calibration(truth):
    """Every alignment is off to the same side, by 30 times of what its points tell."""
    fusion, known = OdometryFusion(), (1e-5) ** 2 * np.eye(6)
    fusion.restart(truth[0], truth[0])
    aside = se3.exp(np.array([0.0, 0.01, 0.0, 0.03, 0.0, 0.0]))
    for i in range(1, N):
        if i % KEPT == 1:
            fusion.change_keyframe()
        pose = fusion.fuse(truth[i], fusion.predict(truth[i]) @ aside, information(1.0), known)
    assert 1e3 * np.linalg.norm((se3.inverse(truth[-1]) @ pose)[:3, 3]) < 1.0


def test_odometry_of_known_precision_that_slips_by_far_is_corrected(truth):
    fusion, known = OdometryFusion(), (1e-3) ** 2 * np.eye(6)
    fusion.restart(truth[0], truth[0])
    fusion.change_keyframe()
    slip = se3.exp(np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]))
    for i in range(1, 10):
        odometry = slip @ truth[i] if i > 5 else truth[i]
        pose = fusion.fuse(odometry, truth[i], information(1.0), known)
    assert 1e3 * np.linalg.norm((se3.inverse(truth[9]) @ pose)[:3, 3]) < 5.0
