"""Frames that the tests of the loop closer share."""

from dataclasses import replace

import numpy as np
import pytest

from slam_bof.geometry import se3


@pytest.fixture(scope="session")
def walk(look, standpoint):
    """Two looks about on the spot, (frame, T_odom_camera) each, so that there are loops."""
    yaws = np.tile(np.arange(0.0, 2.0, 0.1), 2)
    poses = np.tile(np.eye(4), (len(yaws), 1, 1))
    for pose, yaw in zip(poses, yaws, strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        pose[:3] = [[s, 0, c, standpoint[0]], [-c, 0, s, standpoint[1]], [0, -1, 0, 1.3]]
    return [
        (replace(look(T, k), stamp_s=k / 10 + 4.0 * (k // 20)), se3.inverse(poses[0]) @ T)
        for k, T in enumerate(poses)
    ]
