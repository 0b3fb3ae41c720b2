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

__all__ = ["Observability", "is_partial", "observe", "plane_information", "search_weak"]

WEAK = 0.04
"""Share of information below which a direction is tried by shifts."""
SHIFT_M = 0.1
"""How far: by so much points move, also where a direction is a turn."""
MIN_FALL = 0.02
"""A smaller fall of the agreement score leaves a direction open ..."""
MIN_FALL_SIGMAS = 3.0
"""... and so does one of fewer standard errors: this is how the sensor's own noise comes in."""
NOISE_INFORMATION = 0.002
"""Share of information that normals' noise may feign."""
OPEN_INFORMATION = 1e-6
"""Share of information along open directions, next to none."""
CORRELATED = 25.0
"""Neighbouring pixels err alike: so many count as one."""
FLOOR_M = 0.002
"""Standard error that no number of points takes away: calibration, steps of depth."""
MAX_OPEN_M = 0.3
"""A standard error greater than this is of no use to a loop."""
MIN_PAIRS = 30


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
    best_shift_score: float
    """... its agreement, which may be better than that of the pose itself."""

    @property
    def open_axes(self) -> Array:
        """The open directions, (6, k)."""
        return self.axes[:, self.is_open]

    @property
    def open_axes_camera(self) -> Array:
        """The open directions as tangents of the query's pose, (6, k), rotation first."""
        turns = self.open_axes[:3] / self.radius_m
        return np.concatenate([turns, self.open_axes[3:] + np.cross(self.centre, turns, axisb=0).T])

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
    is_open = np.zeros(6, dtype=bool)
    is_open[weak] = (fall < np.maximum(MIN_FALL, MIN_FALL_SIGMAS * error)).all(axis=0)
    best = int(np.argmin(found.fall[1:])) + 1 if len(weak) else 0
    return Observability(
        centre, radius_m, axes, falls, is_open,
        _information(pairs, centre, radius_m, values, axes, falls, is_open),
        float(found.score[0]), T[best], float(found.score[0] - found.fall[best]),
    )  # fmt: skip


def principal_directions(pairs: SurfacePairs) -> tuple[Array, float, Array, Array]:
    """Return centre, radius, and the shares of information (6,), growing, with their axes (6, 6).

    Products are of the query's normals with the match's: their noise does not add up.
    """
    points = pairs.points_query
    centre = points.mean(axis=0)
    offsets = points - centre
    radius_m = float(np.sqrt(np.square(offsets).sum(axis=1).mean()))
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
    falls = np.full(6, np.inf)
    return _information(pairs, centre, radius_m, values, axes, falls, is_open)


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
    *,
    min_gain: float = 0.01,
    rounds: tuple[tuple[int, float, int], ...] = ((64, 0.15, 4), (32, 0.06, 2)),
    seed: int = 0,
) -> tuple[Pose, float, float]:
    """Look for a better pose from other starts (n, 4, 4), then along the weakly held directions.

    Returns the best pose (4, 4), its agreement score, and that of ``T_match_query``.
    """
    rng = np.random.default_rng(seed)
    best = T_match_query
    here = scores(aligner.views, query, match, best[None])
    best_score = first_score = float(here.score[0])
    visible = float(here.visible_ratio[0])
    matches = np.zeros(max(n for n, _, _ in rounds), dtype=np.int64) + match

    def take(tried: Array) -> None:
        nonlocal best, best_score
        T = aligner.refine(query, np.full(len(tried), match), tried)
        found = scores(aligner.views, query, match, T)
        score = np.where(found.visible_ratio >= 0.8 * visible, found.score, -np.inf)
        k = int(np.argmax(score))
        if score[k] > best_score + min_gain:
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
        coarse = aligner.score_poses(query, matches[:1], tried[None])[0]
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
    falls: Array, is_open: NDArray[np.bool_],
) -> Array:  # fmt: skip
    """Return the information (6, 6) of the tangent of the pose, rotation first."""
    spread_m = 1.4826 * float(np.median(np.abs(pairs.residuals_m))) + 1e-4
    n_independent = len(pairs.residuals_m) / CORRELATED
    by_planes = np.maximum(values - NOISE_INFORMATION, OPEN_INFORMATION)
    information = by_planes * n_independent / spread_m**2
    # What depth edges hold, the planes do not: agreement falls by so much over the shift.
    firm = np.isfinite(falls) & ~is_open
    by_edges = np.where(firm, np.maximum(falls, 0.0) / 0.02, 0.0) / SHIFT_M**2
    information = np.where(firm, np.maximum(information, by_edges), information)
    information[is_open] = OPEN_INFORMATION
    information = 1.0 / (1.0 / information + FLOOR_M**2)
    scaled = (axes * information) @ axes.T
    # A tangent about the camera, as displacements about the centre.
    A = np.zeros((6, 6))
    A[:3, :3] = radius_m * np.eye(3)
    x, y, z = centre
    A[3:, :3] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    A[3:, 3:] = np.eye(3)
    return np.asarray(A.T @ scaled @ A)
