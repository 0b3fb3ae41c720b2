"""A table in an empty room, seen by a camera that looks down at it: for tests of levelled views."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.meshes import box, merge
from slam_bof.synthetic.scene import Scene3D
from slam_bof.synthetic.tour import camera_poses
from slam_bof.types import DepthFrame, Intrinsics

CAMERA = Intrinsics(320, 240, 292.5, 292.5, 160.0, 120.0)
WHITE = (0.9, 0.9, 0.9)


def table_frame(
    *,
    table_m: float = 0.72,
    eye_m: float = 1.5,
    ahead_m: float = 2.0,
    pitch: float = 0.4,
    roll: float = 0.0,
) -> DepthFrame:
    """Return the depth of a block 1.2 m wide and 0.6 m deep, so high, before a wall."""
    floor = box(-3.0, -3.0, -0.1, 5.0, 3.0, 0.0, WHITE)
    wall = box(ahead_m + 1.5, -3.0, 0.0, ahead_m + 1.6, 3.0, 2.5, WHITE)
    table = box(ahead_m - 0.3, -0.6, 0.0, ahead_m + 0.3, 0.6, table_m, WHITE)
    pose = camera_poses([0.0, 0.0, eye_m], 0.0, pitch, roll)
    return DepthFrame(0.0, Scene3D(merge([floor, wall, table]), CAMERA).view(pose).depth_m, CAMERA)


def empty_frame() -> DepthFrame:
    return DepthFrame(0.0, np.zeros((240, 320), np.uint16), CAMERA)
