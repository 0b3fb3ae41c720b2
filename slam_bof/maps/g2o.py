"""A pose graph as .g2o: ``VERTEX_SE3:QUAT`` and ``EDGE_SE3:QUAT``, translation first."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Keyframe, Loop, Pose

__all__ = ["write_g2o"]

TRANSLATION_FIRST = [3, 4, 5, 0, 1, 2]
"""Our tangents have the rotation first."""


def write_g2o(
    path: Path,
    keyframes: Sequence[Keyframe],
    T_map_camera: Array,
    loops: Sequence[Loop],
    *,
    odometry_sigma_rad: float,
    odometry_sigma_m: float,
) -> None:
    """Write keyframes at their poses in the map (K, 4, 4), and what ties them.

    Odometry's edges are between neighbours of one segment; between segments it says nothing.
    Loops have their information as it was measured.
    """
    sigmas = np.repeat([odometry_sigma_rad, odometry_sigma_m], 3)
    odometry = np.diag(1.0 / sigmas**2)
    lines = [
        f"VERTEX_SE3:QUAT {k.id} {_pose(T)}" for k, T in zip(keyframes, T_map_camera, strict=True)
    ]
    for before, after in itertools.pairwise(keyframes):
        if before.segment == after.segment:
            T = se3.inverse(before.T_odom_camera) @ after.T_odom_camera
            lines.append(_edge(before.id, after.id, T, odometry))
    lines += [
        _edge(loop.match_id, loop.query_id, loop.T_match_query, loop.information) for loop in loops
    ]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="ascii", newline="\n")


def _edge(from_id: int, to_id: int, T: Pose, information: Array) -> str:
    ordered = information[np.ix_(TRANSLATION_FIRST, TRANSLATION_FIRST)]
    upper = " ".join(map(repr, ordered[np.triu_indices(6)].tolist()))
    return f"EDGE_SE3:QUAT {from_id} {to_id} {_pose(T)} {upper}"


def _pose(T: Pose) -> str:
    return " ".join(map(repr, [*T[:3, 3].tolist(), *se3.to_quaternion(T).tolist()]))
