"""Share of one view's points that falls into the frustums of others."""

from __future__ import annotations

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Intrinsics, Pose

__all__ = ["view_overlap"]

CHUNK = 64
"""Views looked into at a time, that what is computed stays in the cache."""


def view_overlap(
    points_camera: Array,
    T_map_camera: Pose,
    T_map_others: Array,
    intrinsics: Intrinsics,
    max_range_m: float,
) -> Array:
    """Return the share of a view's points that fall into each of the other views.

    Parameters
    ----------
    points_camera
        (N, 3) points that the view sees, in its camera frame.
    T_map_camera, T_map_others
        (4, 4) pose of the view, (K, 4, 4) poses of the others.
    intrinsics, max_range_m
        Image size and depth that bound a view; occlusion is not considered.

    Returns
    -------
    Array
        (K,) shares in [0, 1].
    """
    overlaps = np.zeros(len(T_map_others))
    if len(points_camera) == 0:
        return overlaps
    # Camera and pose in one make x and y times the focal length, and depth: (3, K, 4).
    camera = intrinsics
    T_others_camera = se3.inverse(T_map_others) @ T_map_camera
    scale = np.array([camera.fx, camera.fy, 1.0])
    project = (T_others_camera[:, :3] * scale[:, None]).transpose(1, 0, 2).astype(np.float32)
    points = np.concatenate([points_camera.T, np.ones((1, len(points_camera)))], dtype=np.float32)
    for start in range(0, len(overlaps), CHUNK):
        some = slice(start, start + CHUNK)
        n = len(overlaps[some])
        x, y, z = (project[:, some].reshape(-1, 4) @ points).reshape(3, n, -1)
        inside = (z > 0.0) & (z < max_range_m)
        inside &= (x >= -camera.cx * z) & (x < (camera.width - camera.cx) * z)
        inside &= (y >= -camera.cy * z) & (y < (camera.height - camera.cy) * z)
        overlaps[some] = inside.mean(axis=1)
    return overlaps
