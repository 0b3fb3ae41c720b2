"""Fixtures that many tests share."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from slam_bof.types import Array, DepthFrame, Intrinsics

ROOT = Path(__file__).resolve().parent.parent

CAMERA = Intrinsics(160, 120, 146.25, 146.25, 80.0, 60.0)
"""The 7-Scenes depth camera at a quarter of its size."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the checkout; skips where there is none."""
    path = Path(os.environ.get("SLAM_BOF_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"needs real data: no folder {path}, and SLAM_BOF_SHARED_DATA is not set")
    return path


def box_room_depth_mm(
    camera: Intrinsics, T_world_camera: Array, half_size_m: tuple[float, float, float] = (2, 1.5, 3)
) -> NDArray[np.uint16]:
    """Return the depth (H, W) in mm that a camera sees inside an axis-aligned box around 0.

    Exact but for the rounding to mm: each ray leaves the box through the nearest of the three
    walls that it goes towards.
    """
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays_camera = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )
    rays_world = rays_camera @ T_world_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = np.copysign(half_size_m, rays_world)
        depth_m = ((walls - T_world_camera[:3, 3]) / rays_world).min(axis=-1, initial=np.inf)
    return np.round(1000 * depth_m).astype(np.uint16)


@pytest.fixture
def box_room_frame() -> DepthFrame:
    """A depth frame from the middle of a box room."""
    return DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)
