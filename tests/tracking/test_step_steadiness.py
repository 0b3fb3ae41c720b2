"""Which of odometry and alignment moves more steadily tells which of the two is noisy."""

import json

import numpy as np
import pytest

from slam_bof.tracking.step_steadiness import StepSteadiness

SIGMA = 0.002
WHITEN = np.eye(6) / SIGMA


def learnt(by_odometry, by_alignment, n=60, seed=0):
    """Return what is known after steps of poses that are off by as many sigmas."""
    rng = np.random.default_rng(seed)
    off = (
        rng.standard_normal((2, n, 6))
        * SIGMA
        * np.array([by_odometry, by_alignment])[:, None, None]
    )
    steps = 0.02 + np.diff(off, axis=1)
    steadiness = StepSteadiness()
    for k in range(n - 1):
        steadiness.learn(steps[:, k], WHITEN, WHITEN @ (off[1, k + 1] - off[0, k + 1]))
    return steadiness


def test_alignments_that_err_by_more_than_they_tell_are_known_beside_steady_odometry():
    steadiness = learnt(0.0, 5.0)
    assert not steadiness.alignment_is_steadier
    assert steadiness.alignment_variance == pytest.approx(25.0, rel=0.3)


def test_beside_noisy_odometry_alignments_are_what_they_tell():
    steadiness = learnt(5.0, 1.0)
    assert steadiness.alignment_is_steadier
    assert steadiness.alignment_variance == 1.0


def test_differences_beyond_all_measure_are_those_of_odometry():
    assert learnt(0.0, 100.0).alignment_variance == 1.0


def test_few_steps_tell_nothing():
    assert learnt(0.0, 5.0, n=7).alignment_variance == 1.0


def test_a_step_over_a_frame_without_alignment_does_not_count():
    steadiness = learnt(0.0, 1.0)
    before = steadiness.state()
    steadiness.interrupt()
    steadiness.learn(np.full((2, 6), 9.0), WHITEN, np.zeros(6))
    assert steadiness.state()["unsteadiness"] == before["unsteadiness"]


def test_what_is_known_survives_saving():
    steadiness, restored = learnt(0.0, 5.0), StepSteadiness()
    restored.restore(json.loads(json.dumps(steadiness.state())))
    assert restored.alignment_variance == steadiness.alignment_variance
    assert restored.state() == steadiness.state()
