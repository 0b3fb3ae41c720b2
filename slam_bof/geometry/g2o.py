"""A pose graph as a .g2o file, and the information that its edges have.

The format is that of g2o (ICRA 2011): ``VERTEX_SE3:QUAT id x y z qx qy qz qw``, and
``EDGE_SE3:QUAT a b`` with the pose T_a_b and the upper triangle of a (6, 6) information matrix.
That matrix is for the error [t, q], the translation and the vector part of the quaternion. A
small rotation vector is twice that vector part, so information about rotation is four times that
of the rotation vectors that this package (and GTSAM) use, and mixed terms are twice as large.
GTSAM's own reader does not convert; divide those entries after ``gtsam.readG2o``.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["GraphEdge", "loop_information", "step_sigmas", "write_g2o"]

ROTATION_PER_QUATERNION = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
"""Derivative of our tangent, translation first, with respect to g2o's error."""


class GraphEdge(NamedTuple):
    """A measured pose between two nodes of a pose graph."""

    a: int
    b: int
    T_a_b: Pose
    """(4, 4)."""
    information: Array
    """(6, 6), for the tangent of ``T_a_b``, rotation vector first."""


def loop_information(information: Array, sigma: float) -> Array:
    """Return the information (6, 6) that a loop has in the graph.

    The information of a registration has the right proportions between directions, but not the
    right scale, because the errors of points are not independent. It is scaled so that the mean
    over the six axes is that of a standard deviation ``sigma``, in rad and m.
    """
    return np.asarray(information / np.trace(information) * 6.0 / sigma**2)


def step_sigmas(sigma_rad: float, sigma_m: float) -> Array:
    """Return the standard deviations (6,) of an odometry step between neighbouring keyframes."""
    return np.repeat([sigma_rad, sigma_m], 3)


def write_g2o(path: Path, poses: Iterable[tuple[int, Pose]], edges: Iterable[GraphEdge]) -> None:
    """Write nodes, each an id and a pose (4, 4) in the map, and the edges between them."""
    lines = [f"VERTEX_SE3:QUAT {node} {_pose(T)}" for node, T in poses]
    lines += [f"EDGE_SE3:QUAT {e.a} {e.b} {_pose(e.T_a_b)} {_upper(e.information)}" for e in edges]
    path.write_text("".join(f"{line}\n" for line in lines), encoding="ascii", newline="\n")


def _upper(information: Array) -> str:
    ordered = se3.exchange_blocks(information)  # g2o's tangent has the translation first
    ordered = ordered * np.outer(ROTATION_PER_QUATERNION, ROTATION_PER_QUATERNION)
    return " ".join(map(repr, ordered[np.triu_indices(6)].tolist()))


def _pose(T: Pose) -> str:
    return " ".join(map(repr, [*T[:3, 3].tolist(), *se3.to_quaternion(T).tolist()]))
