"""Which keyframes see the same surfaces, by the poses that the map has for them.

Bags find a place again after long drift; they are blind to the local slip of odometry. Edges
between keyframes that look at the same surfaces mend that.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof import se3
from slam_bof.types import Array, Intrinsics, Params, Pose

__all__ = ["CovisibilityParams", "choose_covisible", "view_overlap"]

CHUNK = 64
"""Views looked into at a time, that what is computed stays in the cache."""


class CovisibilityParams(Params):
    """How many edges a keyframe gets, and what counts as seeing the same."""

    max_edges: int = Field(12, ge=0, description="a keyframe; 0 turns proximity off")
    min_overlap: float = Field(0.35, gt=0, le=1, description="share of points in both views")
    separation: int = Field(2, gt=0, description="keyframes from one choice to the next")
    max_range_m: float = Field(5.0, gt=0, description="how far a view reaches")


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


def choose_covisible(overlaps: Array, params: CovisibilityParams) -> list[int]:
    """Choose up to ``max_edges`` of the views, those that overlap most, but no two in a row.

    ``overlaps`` (K,) are in order of time. Two views close in time say much the same, so that
    the next best one farther off is worth more.

    >>> choose_covisible(np.array([0.6, 0.1, 0.5, 0.7, 0.9]), CovisibilityParams(separation=2))
    [0, 2, 4]
    """
    left = np.where(overlaps >= params.min_overlap, overlaps, 0.0)
    chosen: list[int] = []
    while len(chosen) < params.max_edges and left.any():
        best = int(left.argmax())
        chosen.append(best)
        left[max(0, best - params.separation + 1) : best + params.separation] = 0.0
    return sorted(chosen)
