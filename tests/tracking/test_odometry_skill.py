"""Odometry that errs by more than the camera moves is told from odometry that is of use."""

import json

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.tracking.odometry_fusion import OdometryFusion
from slam_bof.tracking.odometry_skill import OdometrySkill

STEP = np.array([0.02, 0.01, 0.0, 0.03, 0.0, 0.04])


def learnt(error_factor, n=20, step=STEP, seed=0):
    """Return what is known after steps that odometry measures with errors of as many times them."""
    skill = OdometrySkill()
    errors = np.random.default_rng(seed).standard_normal((n, 6)) / np.sqrt(6.0)
    for error in error_factor * np.linalg.norm(step) * errors:
        skill.learn(step + error, -error)
    return skill


@pytest.mark.parametrize(("factor", "is_none"), [(0.0, False), (0.3, False), (3.0, True)])
def test_odometry_tells_nothing_where_it_errs_by_more_than_the_camera_moves(factor, is_none):
    assert learnt(factor).is_none == is_none


def test_where_nothing_is_known_odometry_is_believed():
    assert not OdometrySkill().is_none


def test_odometry_is_needed_by_a_camera_that_stands_still_and_begins_to_move():
    """Meanwhile it errs by millimetres, which is more than the camera moves."""
    assert not learnt(3.0, step=0.05 * STEP).is_none


def test_a_single_slip_is_not_held_against_it():
    skill = learnt(0.0)
    slip = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0])
    skill.learn(STEP + slip, -slip)
    assert not skill.is_none


def test_it_becomes_of_use_again():
    skill = learnt(3.0)
    for _ in range(20):
        skill.learn(STEP, np.zeros(6))
    assert not skill.is_none


def test_a_camera_that_turns_on_the_spot_needs_no_odometry_of_its_translation():
    turn = np.array([0.0, 0.2, 0.0, 0.0, 0.0, 0.0])
    skill = OdometrySkill()
    for error in np.random.default_rng(0).standard_normal((20, 6)) * [0, 0, 0, 0.04, 0.04, 0.04]:
        skill.learn(turn - error, error)
    assert not skill.is_none


def test_what_is_known_survives_saving():
    skill, restored = learnt(3.0), OdometrySkill()
    restored.restore(json.loads(json.dumps(skill.state())))
    assert restored.is_none
    assert restored.state() == skill.state()


def slid_m(odometry_mm, n=120, wall=range(60, 80)):
    """How far, in m, the track slides along a wall that leaves one direction open.

    The camera moves by 10 mm a frame, and odometry errs by as many mm.
    """
    rng, still = np.random.default_rng(0), np.zeros(6)
    way = np.array([0.01, 0.0, 0.0, 0.01, 0.0, 0.0])
    truth = se3.exp(np.arange(n)[:, None] * way)
    fusion = OdometryFusion()
    fusion.restart(truth[0], truth[0])
    fusion.change_keyframe()
    odometry, before = truth[0], truth[0]
    for i in range(1, n):
        error = rng.standard_normal(6) * 1e-3 * odometry_mm
        error[3] += 4.0 * 1e-3 * odometry_mm if i in wall else 0.0
        odometry = odometry @ se3.exp(way) @ se3.exp(error)
        held = np.full(6, 1e6)
        held[3] = 0.0 if i in wall else 1e6
        guess = fusion.predict(odometry)
        off = se3.log(se3.inverse(truth[i]) @ guess)
        aligned = truth[i] @ se3.exp(np.where(held > 0.0, still, off))
        pose = fusion.fuse(odometry, aligned, np.diag(held))
        if i == wall.start - 1:
            before = se3.inverse(truth[i]) @ pose
        if i == wall.stop - 1:
            slid = se3.inverse(before) @ se3.inverse(truth[i]) @ pose
            return float(np.linalg.norm(slid[:3, 3]))
    raise AssertionError


def test_odometry_that_slips_does_not_lead_along_open_directions():
    assert slid_m(0.0) < 1e-6
    assert slid_m(60.0) < 0.25  # it stands still, as the camera does not
    assert 20 * 4 * 0.06 > 4.0  # is how far odometry slides meanwhile
