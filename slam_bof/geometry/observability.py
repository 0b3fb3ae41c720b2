"""Which directions of a relative pose two views hold, how firmly, and whether a better one is near.

The curvature of point-to-plane residuals does not tell: it knows nothing of wrong minima, and what
is left of it by noise or by the pattern of a sensor's steps looks like information. What tells is
by how much two views agree less when one is shifted along a direction that the surfaces hold
weakly. Where agreement does not fall, the direction is open: an alignment says nothing along it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.geometry.projective_icp import SurfacePairs, ViewAligner
from slam_bof.geometry.visibility import scores
from slam_bof.types import Array, Pose

__all__ = [
    "Observability",
    "PosePrior",
    "is_partial",
    "observe",
    "plane_information",
    "search_weak",
]

WEAK = 0.04
"""Share of information below which a direction is tried by shifts."""
SHIFT_M = 0.1
"""How far: by so much points move, also where a direction is a turn."""
MIN_FALL = 0.02
"""A smaller fall of the agreement score leaves a direction open ..."""
MIN_FALL_SIGMAS = 3.0
"""... and so does one of fewer standard errors: this is how the sensor's own noise comes in."""
MIN_GAIN, MIN_GAIN_SIGMAS = 0.01, 1.0
"""Another pose must agree better by at least so much, and so many standard errors."""
MAX_DISTANCE = 25.0
"""No pose is less likely than by so many standard errors squared: odometry may slip."""
NOISE_INFORMATION = 0.0008
"""Share of information that normals' noise may feign."""
OPEN_INFORMATION = 1e-6
"""Share of information along open directions, next to none."""
MIN_FALL_ERROR = 0.005
CORRELATED = 8.0
"""Neighbouring pixels err alike: so many count as one."""
FLOOR_M = 0.002
"""Standard error that no number of points takes away: calibration, steps of depth."""
MAX_OPEN_M = 0.2
"""A standard error greater than this is of no use to a loop."""
MIN_RADIUS_M = 0.05
MIN_PAIRS = 30


class PosePrior(NamedTuple):
    """Where a pose (4, 4) should be, with what covariance (6, 6), rotation first."""

    T_match_query: Pose
    covariance: Array

    def distance(self, T: Array) -> Array:
        """Return the squared distances (n,) of poses (n, 4, 4), in standard errors, bounded."""
        off = se3.log(se3.inverse(self.T_match_query) @ T)
        whitened = np.einsum("ni,ij,nj->n", off, np.linalg.inv(self.covariance), off)
        return np.asarray(np.minimum(whitened, MAX_DISTANCE))


class Observability(NamedTuple):
    """What holds a pose ``T_match_query``.

    Directions are columns of ``axes`` (6, 6): displacements of the query, in metres, as a turn
    about ``centre`` (3,) times ``radius_m``, then a translation, all in the query's camera frame.
    """

    centre: Array
    radius_m: float
    axes: Array
    falls: Array
    """(6,) by how much the agreement score falls when shifted, the greater of both ways; inf where
    the surfaces hold firmly."""
    is_open: NDArray[np.bool_]
    """(6,) which directions nothing holds."""
    information: Array
    """(6, 6) of the tangent of ``T_match_query``, rotation first, in rad and m."""
    score: float
    best_shift: Pose
    """(4, 4) ``T_match_query`` of the best shifted pose, and ..."""
    is_better_near: bool
    """... whether that agrees better than the pose itself, beyond chance."""

    @property
    def open_axes(self) -> Array:
        """The open directions, (6, k)."""
        return self.axes[:, self.is_open]

    @property
    def open_axes_camera(self) -> Array:
        """The open directions as tangents of the query's pose, (6, k), rotation first."""
        turns = self.open_axes[:3] / self.radius_m
        return np.concatenate([turns, self.open_axes[3:] + np.cross(self.centre, turns, axisb=0).T])

    def weak_sigma_m(self, covariance: Array) -> float:
        """Return the greatest standard error, in m, along weak directions of a prior (6, 6)."""
        weak = self.axes[:, np.isfinite(self.falls)]
        if weak.shape[1] == 0:
            return 0.0
        to_displacement = _displacement_of_tangent(self.centre, self.radius_m)
        spread = to_displacement @ covariance @ to_displacement.T
        return float(np.sqrt(np.einsum("ik,ij,jk->k", weak, spread, weak).max()))

    def keep_open(self, T: Pose, T_guess: Pose) -> Pose:
        """Return a pose (4, 4) as ``T_guess`` has it along open directions, as ``T`` else."""
        if not self.is_open.any():
            return T
        off = self._coordinates(se3.inverse(T) @ T_guess)
        return T @ self._motion(self.open_axes @ (self.open_axes.T @ off))

    def _motion(self, displacement: Array) -> Pose:
        return displace(displacement, self.centre, self.radius_m)

    def _coordinates(self, T: Pose) -> Array:
        turn = se3.log(T)[:3]
        shift = T[:3, 3] - self.centre + T[:3, :3] @ self.centre
        return np.concatenate([turn * self.radius_m, shift])


def observe(
    aligner: ViewAligner, query: int, match: int, T_match_query: Pose, *, n_points: int = 400
) -> Observability | None:
    """Find out which directions of an aligned pair's pose the surfaces hold.

    Returns nothing where hardly any surfaces meet.
    """
    (pairs,) = aligner.surface_pairs(query, np.array([match]), T_match_query[None])
    if len(pairs.residuals_m) < MIN_PAIRS:
        return None
    centre, radius_m, values, axes = principal_directions(pairs)
    weak = np.flatnonzero(values < WEAK)
    shifts = np.concatenate([SHIFT_M * axes.T[weak], -SHIFT_M * axes.T[weak]])
    T = np.array([T_match_query, *(T_match_query @ displace(s, centre, radius_m) for s in shifts)])
    found = scores(aligner.views, query, match, T, n_points)
    fall, error = found.fall, found.fall_error
    fall, error = fall[1:].reshape(2, -1), error[1:].reshape(2, -1)
    falls = np.full(6, np.inf)
    falls[weak] = fall.max(axis=0)
    sigmas = np.full(6, np.inf)
    sigmas[weak] = (fall / np.maximum(error, MIN_FALL_ERROR)).max(axis=0)
    is_open = np.zeros(6, dtype=bool)
    is_open[weak] = (fall < np.maximum(MIN_FALL, MIN_FALL_SIGMAS * error)).all(axis=0)
    best = int(np.argmin(found.fall[1:])) + 1 if len(weak) else 0
    least_gain = max(MIN_GAIN, MIN_GAIN_SIGMAS * float(found.fall_error[best]))
    return Observability(
        centre, radius_m, axes, falls, is_open,
        _information(pairs, centre, radius_m, values, axes, sigmas, is_open),
        float(found.score[0]), T[best], bool(-found.fall[best] > least_gain),
    )  # fmt: skip


def principal_directions(pairs: SurfacePairs) -> tuple[Array, float, Array, Array]:
    """Return centre, radius, and the shares of information (6,), growing, with their axes (6, 6).

    Products are of the query's normals with the match's: their noise does not add up.
    """
    points = pairs.points_query
    centre = points.mean(axis=0)
    offsets = points - centre
    radius_m = max(float(np.sqrt(np.square(offsets).sum(axis=1).mean())), MIN_RADIUS_M)
    offsets = offsets / radius_m
    by_query, by_match = (
        np.hstack([np.cross(offsets, normals), normals])
        for normals in (pairs.facing_query, pairs.normals_query)
    )
    cross = by_query.T @ by_match / len(points)
    values, axes = np.linalg.eigh(0.5 * (cross + cross.T))
    return centre, radius_m, values, axes


def plane_information(
    points_query: Array, facing_query: Array, normals_query: Array, residuals_m: Array
) -> Array:
    """Return the information (6, 6) of a pose that points on planes have, without trying shifts.

    Parameters are those of ``SurfacePairs``.
    """
    pairs = SurfacePairs(points_query, normals_query, facing_query, residuals_m)
    if len(residuals_m) == 0:
        return np.zeros((6, 6))
    centre, radius_m, values, axes = principal_directions(pairs)
    is_open = values < 2.0 * NOISE_INFORMATION
    sigmas = np.where(is_open, 0.0, np.inf)
    return _information(pairs, centre, radius_m, values, axes, sigmas, is_open)


def is_partial(information: Array, *, lever_m: float = 1.0) -> bool:
    """Tell whether an edge's information (6, 6) leaves a direction open, to ``MAX_OPEN_M``."""
    scale = np.repeat([1.0 / lever_m, 1.0], 3)
    return bool(np.linalg.eigvalsh(information * np.outer(scale, scale))[0] < MAX_OPEN_M**-2)


def search_weak(
    aligner: ViewAligner,
    query: int,
    match: int,
    T_match_query: Pose,
    starts: Array,
    prior: PosePrior,
    *,
    rounds: tuple[tuple[int, float, int], ...] = ((64, 0.15, 4), (32, 0.06, 2)),
    seed: int = 0,
) -> tuple[Pose, float, float]:
    """Look for a better pose from other starts (n, 4, 4), then along the weakly held directions.

    Another pose must agree better beyond chance, and the farther it is from where the prior has it
    the more so: what it gains, in standard errors squared, must exceed what it costs.

    Returns the best pose (4, 4), its agreement score, and that of ``T_match_query``.
    """
    rng = np.random.default_rng(seed)
    best = T_match_query
    here = scores(aligner.views, query, match, best[None])
    best_score = first_score = float(here.score[0])
    visible = float(here.visible_ratio[0])

    def take(tried: Array) -> None:
        nonlocal best, best_score
        T = np.array([best, *aligner.refine(query, np.full(len(tried), match), tried)])
        found = scores(aligner.views, query, match, T)
        score = np.where(found.visible_ratio >= 0.8 * visible, found.score, -np.inf)
        gain = np.minimum(score - score[0], -found.fall)
        cost = prior.distance(T) - prior.distance(T[:1])
        sigmas = np.sqrt(MIN_GAIN_SIGMAS**2 + np.maximum(cost, 0.0))
        worth = gain - np.maximum(MIN_GAIN, sigmas * found.fall_error)
        k = int(np.argmax(np.where(worth[1:] > 0.0, gain[1:], -np.inf))) + 1
        if worth[k] > 0.0:
            best, best_score = T[k], float(score[k])

    if len(starts):
        take(starts)
    for n, sigma_m, n_best in rounds:
        (pairs,) = aligner.surface_pairs(query, np.array([match]), best[None])
        if len(pairs.residuals_m) < MIN_PAIRS:
            break
        centre, radius_m, values, axes = principal_directions(pairs)
        weak = axes[:, : int(np.clip((values < WEAK).sum(), 1, 4))]
        displacements = sigma_m * rng.standard_normal((n, weak.shape[1])) @ weak.T
        tried = best @ displace(displacements, centre, radius_m)
        coarse = aligner.score_poses(query, np.array([match]), tried[None])[0]
        take(tried[np.argsort(-coarse, kind="stable")[:n_best]])
    return best, best_score, first_score


def displace(displacement: Array, centre: Array, radius_m: float) -> Pose:
    """Return the motions (..., 4, 4) of displacements (..., 6) about a centre."""
    tangent = np.zeros_like(displacement)
    tangent[..., :3] = displacement[..., :3] / radius_m
    T = se3.exp(tangent)
    T[..., :3, 3] = displacement[..., 3:] + centre - T[..., :3, :3] @ centre
    return T


def _information(
    pairs: SurfacePairs, centre: Array, radius_m: float, values: Array, axes: Array,
    fall_sigmas: Array, is_open: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Return the information (6, 6) of the tangent of the pose, rotation first.

    ``fall_sigmas`` (6,) are falls in standard errors, infinite where none was measured.
    """
    spread_m = 1.4826 * float(np.median(np.abs(pairs.residuals_m))) + 1e-4
    n_independent = len(pairs.residuals_m) / CORRELATED
    by_planes = np.maximum(values - NOISE_INFORMATION, OPEN_INFORMATION)
    information = by_planes * n_independent / spread_m**2
    # Planes say nothing of what depth edges hold: agreement falls steadily over the shift, so the
    # pose is known to the part of it over which the fall is one standard error.
    # Where it hardly falls, planes are not believed either.
    doubt = np.where(np.isfinite(fall_sigmas), np.maximum(fall_sigmas, 0.0), MIN_FALL_SIGMAS)
    information = information * np.square(np.minimum(doubt / MIN_FALL_SIGMAS, 1.0))
    information = np.maximum(information, np.square(doubt / SHIFT_M) * np.isfinite(fall_sigmas))
    information = np.where(is_open, np.minimum(information, MAX_OPEN_M**-2), information)
    information = np.maximum(information, OPEN_INFORMATION)
    information = 1.0 / (1.0 / information + FLOOR_M**2)
    scaled = (axes * information) @ axes.T
    A = _displacement_of_tangent(centre, radius_m)
    return np.asarray(A.T @ scaled @ A)


def _displacement_of_tangent(centre: Array, radius_m: float) -> Array:
    """Return the (6, 6) that makes a tangent about the camera a displacement about the centre."""
    A = np.zeros((6, 6))
    A[:3, :3] = radius_m * np.eye(3)
    x, y, z = centre
    A[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    A[3:, 3:] = np.eye(3)
    return A
