"""Pose graphs of a camera on a circle, for the tests of back-ends."""

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Bag, Keyframe, Loop

N = 24
EMPTY = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def circle():
    """True poses on a closed circle of 2 m, and odometry that drifts along it."""
    step = se3.exp(np.array([0.0, 2 * np.pi / N, 0.0, 0.0, 0.0, 2.0 * np.pi / N]))
    drift = se3.exp(np.array([0.002, 0.004, 0.0, 0.003, -0.002, 0.003]))
    truth, odometry = [np.eye(4)], [np.eye(4)]
    for _ in range(N):
        truth.append(truth[-1] @ step)
        odometry.append(odometry[-1] @ step @ drift)
    return np.array(truth), np.array(odometry)


def error_m(poses, truth):
    return np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1).max()


def loop(truth, query_id, match_id, *, information=None, wrong=None, kind="loop"):
    T = se3.inverse(truth[match_id]) @ truth[query_id]
    return Loop(
        query_id,
        match_id,
        T if wrong is None else T @ wrong,
        100.0 * np.eye(6) if information is None else information,
        kind,
        "bag",
    )


def add_keyframes(backend, poses, period_s=1.0):
    for i, T in enumerate(poses):
        backend.add_keyframe(Keyframe(i, i, period_s * i, T, EMPTY, None))
        backend.update()
