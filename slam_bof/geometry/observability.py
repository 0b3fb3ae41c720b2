"""Which directions of a relative pose the surfaces hold.

The eigenvalues of the point-to-plane equations do not answer this: they know nothing of other
minima, and nothing of what depth edges hold. Instead, one view is shifted by 0.1 m either way along
each weakly held direction. If the views agree as well as before, the direction is open: an
alignment says nothing along it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slam_bof.core import compiled
from slam_bof.geometry import se3
from slam_bof.geometry.point_to_plane import fill_derivative
from slam_bof.geometry.projective_icp import SurfacePairs, ViewAligner
from slam_bof.types import Array, Pose

__all__ = ["PrincipalDirections", "cross_information", "open_directions"]

MAX_WEAK_INFORMATION = 0.04
"""Share of the points' information below which a direction is weakly held."""
SHIFT_M = 0.1
"""Views are shifted by this distance to measure how far their agreement drops."""
MIN_SCORE_DROP = 0.02
"""A direction is open if agreement drops by less than this, whichever way the view is shifted."""
OPEN_INFORMATION = 1e-6
"""Share of the information that is kept along open directions, so that it stays invertible."""
KEEP_ITERATIONS = 2
"""Linear steps of ``keep``; what the first leaves is of second order in the turn."""
HELD_INFORMATION = 1e-4
"""Least share of the information along a direction that is not open."""
NOISE_FACTOR = 1.5
"""Standard deviation of an alignment, as a multiple of what it were if the residuals of all points
were independent. Neighbours err alike; on synthetic scenes the factor is 1.1 to 2.7, whatever the
sensor and the direction."""
MIN_VARIANCE_M2 = 1e-10
"""Least variance of an alignment: exact depth, as of tests, would make its information infinite."""
MIN_PAIRS = 30
"""Least number of pairs: five for each of the six directions."""
MIN_RADIUS_M = 0.05
"""Least radius of the points, by which their moments are divided."""


class PrincipalDirections(NamedTuple):
    """The principal directions of the information in point-to-plane pairs.

    Directions are the columns of ``axes`` (6, 6). They are displacements in metres, in the query's
    camera frame: a rotation about ``centre`` (3,) times ``radius_m``, then a translation.
    ``information`` (6,) is the mean over the points for each direction, in ascending order.
    ``variance`` is that of an aligned pose along a direction of information 1, in m^2.
    """

    centre: Array
    radius_m: float
    information: Array
    axes: Array
    variance: float

    @classmethod
    def of(cls, pairs: SurfacePairs, min_pairs: int = MIN_PAIRS) -> PrincipalDirections | None:
        """Return the principal directions of pairs, or None if there are too few pairs.

        The normals of the query are multiplied with those of the match. As their noise is
        independent, it does not count as information.
        """
        points = pairs.points_query
        if len(points) < min_pairs:
            return None
        centre, radius_m, cross = cross_information(points, pairs.facing_query, pairs.normals_query)
        information, axes = np.linalg.eigh(0.5 * (cross + cross.T))
        variance = NOISE_FACTOR**2 * np.mean(np.square(pairs.residuals_m)) / len(points)
        return cls(centre, radius_m, information, axes, max(float(variance), MIN_VARIANCE_M2))

    @property
    def weak_axes(self) -> Array:
        """The axes (6, k) of the directions that are weakly held."""
        return self.axes[:, self.information < MAX_WEAK_INFORMATION]

    def displace(self, displacement: Array) -> Pose:
        """Return the motions (..., 4, 4) of displacements (..., 6)."""
        tangent = np.zeros_like(displacement)
        tangent[..., :3] = displacement[..., :3] / self.radius_m
        T = se3.exp(tangent)
        T[..., :3, 3] = displacement[..., 3:] + self.centre - T[..., :3, :3] @ self.centre
        return T

    def displacement(self, T: Pose) -> Array:
        """Return the displacement (6,) of a small motion (4, 4)."""
        turn = se3.log(T)[:3]
        shift = T[:3, 3] - self.centre + T[:3, :3] @ self.centre
        return np.concatenate([turn * self.radius_m, shift])

    def of_tangent(self) -> Array:
        """Return the matrix (6, 6) from a tangent, rotation first, to its displacement."""
        x, y, z = self.centre
        A = np.zeros((6, 6))
        A[:3, :3] = self.radius_m * np.eye(3)
        A[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
        A[3:, 3:] = np.eye(3)
        return A

    def pose_information(self, open_axes: Array) -> Array:
        """Return the information (6, 6) of the tangent of an aligned pose, none along axes (6, k).

        It is the inverse of its covariance, in 1/rad^2 and 1/m^2, rotation first.
        """
        A = self.of_tangent()
        held = np.eye(6) - open_axes @ open_axes.T
        values = np.maximum(self.information, HELD_INFORMATION) / self.variance
        return np.asarray(A.T @ held @ (self.axes * values) @ self.axes.T @ held @ A)

    def without(self, information: Array, axes: Array) -> Array:
        """Return the information (6, 6) of a pose's tangent, reduced to almost none along axes."""
        A = self.of_tangent()
        inverse = np.linalg.inv(A)
        held = np.eye(6) - axes @ axes.T
        kept = held @ inverse.T @ information @ inverse @ held
        kept += OPEN_INFORMATION * np.trace(kept) * axes @ axes.T
        return np.asarray(A.T @ kept @ A)

    def keep(self, axes: Array, T: Pose, T_guess: Pose) -> Pose:
        """Return the pose (4, 4) nearest to ``T_guess`` that differs from ``T`` along axes (6, k).

        Nearest as the camera moves, with 1 rad like 1 m. An alignment that turns the camera before
        a wall says nothing of where the camera is along the wall: it turns about itself, as
        odometry errs, and not about what it looks at.
        """
        held = np.linalg.svd(axes)[0][:, axes.shape[1] :].T
        constraints = held @ self.of_tangent()
        T_kept = T_guess
        for _ in range(KEEP_ITERATIONS):
            off = held @ self.displacement(se3.inverse(T) @ T_kept)
            T_kept = T_kept @ se3.exp(-np.linalg.pinv(constraints) @ off)
        return T_kept


@compiled
def cross_information(
    points: Array, normals_query: Array, normals_match: Array
) -> tuple[Array, float, Array]:
    """Return centre (3,) and radius of points (m, 3), and the mean (6, 6) of products of rows.

    A row is the derivative of a residual along a normal by the displacement of the point; those of
    the query's normals are multiplied with those of the match's.
    """
    m = len(points)
    centre, square = np.zeros(3), 0.0
    for k in range(m):
        for i in range(3):
            centre[i] += points[k, i] / m
            square += points[k, i] * points[k, i] / m
    radius_m = max(np.sqrt(max(square - (centre * centre).sum(), 0.0)), MIN_RADIUS_M)
    cross = np.zeros((6, 6))
    by_query, by_match = np.empty(6), np.empty(6)
    for k in range(m):
        x = (points[k, 0] - centre[0]) / radius_m
        y = (points[k, 1] - centre[1]) / radius_m
        z = (points[k, 2] - centre[2]) / radius_m
        fill_derivative(by_query, x, y, z, normals_query[k], 1.0 / m)
        fill_derivative(by_match, x, y, z, normals_match[k], 1.0)
        for i in range(6):
            for j in range(6):
                cross[i, j] += by_query[i] * by_match[j]
    return centre, radius_m, cross


def open_directions(
    aligner: ViewAligner,
    query: int,
    match: int,
    T_match_query: Pose,
    *,
    min_pairs: int = MIN_PAIRS,
) -> tuple[PrincipalDirections, Array] | None:
    """Return the principal directions of an aligned pair, and the axes (6, k) that are open.

    None is returned if fewer than ``min_pairs`` points meet a surface.
    """
    (pairs,) = aligner.surface_pairs(query, np.array([match]), T_match_query[None])
    directions = PrincipalDirections.of(pairs, min_pairs)
    if directions is None:
        return None
    weak = directions.weak_axes
    if weak.shape[1] == 0:
        return directions, weak
    shifts = SHIFT_M * np.concatenate([weak.T, -weak.T])
    tried = np.concatenate([T_match_query[None], T_match_query @ directions.displace(shifts)])
    one_way, other_way = tried[: 1 + weak.shape[1]], tried[1 + weak.shape[1] :]

    def score(T: Array) -> Array:
        return np.asarray(aligner.agreement_score(query, np.full(len(T), match), T).score)

    here, *shifted = score(one_way)
    is_open = here - np.array(shifted) < MIN_SCORE_DROP
    if is_open.any():  # the others are held already
        is_open[is_open] = here - score(other_way[is_open]) < MIN_SCORE_DROP
    return directions, weak[:, is_open]
