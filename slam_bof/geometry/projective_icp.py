"""Align one view with many at once, and measure how far they agree.

A pose is good where the points of either view, seen from the other, lie at the depth that the
other has there: *seen* by it. Points that would stand in front of what it sees contradict:
*blocking*. First a random search about starting poses, scored by few points; then point-to-plane
ICP with projective association (Blais and Levine 1995), all pairs in one batch, by few points
until they are close.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.spatial.transform import Rotation

from slam_bof.geometry import se3
from slam_bof.geometry.depth_view import View
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.geometry.visibility import Agreement, Coverage, agreement, coverage, tell
from slam_bof.types import Array, Params

__all__ = ["AlignmentParams", "SurfacePairs", "ViewAligner"]

ORBIT_M = 2.0
"""Half the random motions turn about a point so far ahead, at which the camera keeps looking."""
MIN_COSINE = 0.6
"""Between the normals of points that match."""
CHUNK = 2**15
"""Points computed at a time, that they stay in the cache."""


class AlignmentParams(Params):
    """How hard a pose is searched for, and what counts as seeing the same."""

    n_points: int = Field(400, gt=0, description="of a view that ICP and agreement look at")
    n_search_points: int = Field(100, gt=0, description="of which so many score a random pose")
    n_poses: int = Field(32, gt=0, description="random poses about each start, in a round")
    n_rounds: int = Field(3, gt=0, description="each about the two best, half as far")
    sigma_deg: tuple[float, float, float] = Field((6.0, 7.0, 5.0), description="about x, y, z")
    sigma_m: tuple[float, float, float] = Field((0.25, 0.15, 0.25), description="along x, y, z")
    search_tolerance: tuple[float, float] = Field((0.1, 0.03), description="m, and share of depth")
    n_iterations: int = Field(12, gt=0, description="of ICP")
    n_fine_iterations: int = Field(8, ge=0, description="of which the last look at all points")
    n_coarse_points: int = Field(1000, gt=0, description="that the others look at")
    gates_m: tuple[float, float] = Field((0.3, 0.1), description="of ICP, first and last")
    rest: float = Field(1e-3, ge=0, description="rad and m; who moves less waits for ...")
    n_last_iterations: int = Field(2, ge=0, description="... so many iterations at the end")
    tolerance: tuple[float, float] = Field((0.05, 0.02), description="m, and share of depth")


class SurfacePairs(NamedTuple):
    """Points of a query that lie on a surface of the match, all in the query's camera frame."""

    points_query: Array
    """(M, 3)."""
    normals_query: Array
    """(M, 3), of the match's surface."""
    residuals_m: Array
    """(M,) from the point to the surface, along the normal."""


class _Association(NamedTuple):
    """For n matches and m points, in the matches' frames; one coordinate after the other."""

    points: Floats
    """(n, 3, m)."""
    normals: Floats
    """(n, 3, m), of the matches' surfaces."""
    residuals_m: Floats
    """(n, m)."""
    matched: NDArray[np.bool_]
    """(n, m)."""


class ViewAligner:
    """Holds views of one camera, and aligns one of them with others."""

    def __init__(self, params: AlignmentParams, *, seed: int = 0) -> None:
        self.params = params
        self._views = ViewStack(params.n_points, seed=seed)
        self._motions = _random_motions(params, seed)

    def add(self, view: View) -> None:
        """Hold another view; ids count from 0.

        Raises
        ------
        ValueError
            If it is of another camera than the views before.
        """
        self._views.add(view)

    def __len__(self) -> int:
        """Return the number of views held."""
        return len(self._views)

    def truncate(self, n: int) -> None:
        """Hold only the first ``n`` views."""
        self._views.truncate(n)

    @property
    def nbytes(self) -> int:
        """Bytes of all views held."""
        return self._views.nbytes

    def points_camera(self, view_id: int) -> NDArray[np.float32]:
        """Return the points (N, 3) of a view."""
        return self._views.points_camera(view_id)

    def sampled(self, view_id: int, n_points: int) -> Array:
        """Return ``n_points`` points (n, 3) of a view, ``params.n_points`` at most."""
        return self._views.sampled(view_id, n_points).astype(np.float64)

    def align(self, query: int, matches: Indices, starts: Array) -> Array:
        """Return ``T_match_query`` (n, 4, 4) that fit best, from starts (n, S, 4, 4)."""
        return self.refine(query, matches, self._search(query, matches, starts.astype(np.float32)))

    def refine(self, query: int, matches: Indices, T_match_query: Floats) -> Array:
        """Return ``T_match_query`` (n, 4, 4) as point-to-plane ICP has them, all in one batch.

        Pairs that have come to rest wait for the last iterations, whose gates are the narrowest.
        """
        p = self.params
        T: Floats = T_match_query.astype(np.float32)
        moving = np.ones(len(matches), np.bool_)
        for k, gate_m in enumerate(np.geomspace(*p.gates_m, p.n_iterations).astype(np.float32)):
            fine = k >= p.n_iterations - p.n_fine_iterations
            n_points = p.n_points if fine else min(p.n_points, p.n_coarse_points)
            if k >= p.n_iterations - p.n_last_iterations:
                moving[:] = True
            left = np.flatnonzero(moving)
            for some in _chunks(len(left), n_points):
                pairs = left[some]
                found = self._associate(query, matches[pairs], T[pairs], gate_m, n_points)
                steps = _step(found, gate_m)
                T[pairs] = _exp(steps) @ T[pairs]
                moving[pairs] = np.abs(steps).max(axis=1) > p.rest
        return T.astype(np.float64)

    def surface_pairs(
        self, query: int, matches: Indices, T_match_query: Array
    ) -> list[SurfacePairs]:
        """Return what the query sees of each match's surfaces at poses (n, 4, 4).

        That is within the last gate.
        """
        gate_m = np.float32(self.params.gates_m[-1])
        T = T_match_query.astype(np.float32)
        found = self._associate(query, matches, T, gate_m, self.params.n_points)
        points = self._views.surface(query)[0].astype(np.float64)
        pairs = []
        for k, matched in enumerate(found.matched):
            normals = found.normals[k][:, matched].T @ T_match_query[k, :3, :3]
            residuals_m = found.residuals_m[k][matched].astype(np.float64)
            pairs.append(SurfacePairs(points[matched], normals, residuals_m))
        return pairs

    def seen(self, query: int, matches: Indices, T_match_query: Array) -> tuple[Floats, Floats]:
        """Return the shares (n,) of the query's points that each match sees, and that block it."""
        points = self._views.sampled(query)
        T = T_match_query.astype(np.float32)
        told = tell(self._views, points, matches, T, self.params.tolerance)
        return told.seen.mean(axis=1), told.blocking.mean(axis=1)

    def agreement(self, query: int, matches: Indices, T_match_query: Array) -> Agreement:
        """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
        return agreement(self._views, query, matches, T_match_query, self.params.tolerance)

    def coverage(self, query: int, matches: Indices, T_match_query: Array) -> Coverage:
        """Measure how far the query agrees with all matches (n,) together at poses (n, 4, 4)."""
        return coverage(self._views, query, matches, T_match_query, self.params.tolerance)

    def _search(self, query: int, matches: Indices, starts: Floats) -> Floats:
        """Return the best of random poses about the starts, in rounds of smaller motions."""
        points = self._views.sampled(query, self.params.n_search_points)
        tolerance = np.array(self.params.search_tolerance, np.float32)
        for motions in self._motions:
            tried = np.matmul(motions, starts[:, :, None]).reshape(len(starts), -1, 4, 4)
            scores = np.empty(tried.shape[:2], np.float32)
            for some in _chunks(len(matches), scores.shape[1] * len(points)):
                scores[some] = self._score(points, matches[some], tried[some], tolerance)
            best = np.argsort(-scores, axis=1, kind="stable")[:, :2]
            starts = np.take_along_axis(tried, best[..., None, None], axis=1)
            tolerance = tolerance * np.float32(0.7)
        return starts[:, 0]

    def _score(self, points: Floats, matches: Indices, poses: Floats, tolerance: Floats) -> Floats:
        """Score poses (n, P, 4, 4): points at the depth that is there count, blocking ones cost."""
        n, n_poses = poses.shape[:2]
        fallen = self._views.fall(points, poses.reshape(-1, 4, 4))
        there, _ = self._views.look(np.repeat(matches, n_poses), fallen)
        known = there > 0
        off = fallen.depth_m
        off -= there
        there *= tolerance[1]
        there += tolerance[0]
        off /= there
        blocking = off < -1.0
        worth = np.abs(off, out=off)
        np.subtract(np.float32(1.0), worth, out=worth)
        np.maximum(worth, np.float32(0.0), out=worth)
        worth -= np.float32(0.5) * blocking
        worth *= known
        return np.asarray(worth.mean(axis=1).reshape(n, n_poses))

    def _associate(
        self, query: int, matches: Indices, T: Floats, gate_m: np.float32, n_points: int
    ) -> _Association:
        """Pair the query's surface points with what the others see at the pixels they fall on."""
        points, facing = self._views.surface(query, n_points)
        fallen = self._views.fall(points, T)
        gap, normals = self._views.surface_there(matches, fallen)
        moved = _rotate(T, points)
        moved += T[:, :3, 3:]
        gap -= moved
        residuals_m = _dot(gap, normals)
        # Where nothing is known the normal is zero, and so is the cosine.
        matched = _dot(normals, _rotate(T, facing)) > MIN_COSINE
        matched &= fallen.inside
        matched &= _dot(gap, gap) < 4.0 * gate_m**2
        matched &= np.abs(residuals_m) < gate_m
        return _Association(moved, normals, residuals_m, matched)


def _chunks(n: int, n_each: int) -> Iterator[slice]:
    """Slice n pairs, of so many points each, into chunks."""
    step = max(1, CHUNK // n_each)
    return (slice(start, start + step) for start in range(0, n, step))


def _random_motions(params: AlignmentParams, seed: int) -> list[Floats]:
    """Return the motions (n_poses, 4, 4) of each round, the first of which stays."""
    random = np.random.default_rng(seed)
    sigma = np.concatenate([np.radians(params.sigma_deg), params.sigma_m])
    n = params.n_poses
    rounds = []
    for k in range(params.n_rounds):
        tangent = sigma * 0.5**k * random.standard_normal((n, 6))
        tangent[0] = 0.0
        T = np.tile(np.eye(4), (n, 1, 1))
        T[:, :3, :3] = se3.exp(np.pad(tangent[:, :3], ((0, 0), (0, 3))))[:, :3, :3]
        T[:, :3, 3] = tangent[:, 3:]
        orbiting = random.random(n) < 0.5
        orbiting[0] = False
        centre = np.array([0.0, 0.0, ORBIT_M])
        T[orbiting, :3, 3] += centre - T[orbiting, :3, :3] @ centre
        rounds.append(T.astype(np.float32))
    return rounds


def _rotate(T: Floats, vectors: Floats) -> Floats:
    """Return vectors (m, 3) turned by each of (n, 4, 4), coordinate by coordinate: (n, 3, m)."""
    turns = np.ascontiguousarray(T[:, :3, :3]).reshape(-1, 3)
    return np.asarray(turns @ vectors.T).reshape(len(T), 3, -1)


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the dot products (n, m) of vectors (n, 3, m)."""
    return np.asarray(a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2])


def _step(found: _Association, gate_m: np.float32) -> Floats:
    """Return the small motions (n, 6), rotation first, of damped weighted least squares."""
    points, normals, residuals_m, matched = found
    x, y, z = points.transpose(1, 0, 2)
    a, b, c = normals.transpose(1, 0, 2)
    n, _, m = points.shape
    rows = np.empty((n, 7, m), np.float32)
    rows[:, 0] = y * c - z * b
    rows[:, 1] = z * a - x * c
    rows[:, 2] = x * b - y * a
    rows[:, 3:6] = normals
    rows[:, 6] = residuals_m
    # Geman-McClure, and less for what is far, whose depth is less sure.
    weight = residuals_m * (np.float32(2.0) / gate_m)
    weight *= weight
    weight += np.float32(1.0)
    weight *= weight
    weight *= np.float32(0.2) + np.float32(0.2) * z * z
    np.divide(matched, weight, out=weight)
    products = (rows[:, :6] * weight[:, None]) @ rows.transpose(0, 2, 1)
    normal_matrix, gradient = products[..., :6], products[..., 6:]
    # What the surfaces leave open stays as it is.
    damping = 1e-3 + 0.0005 * np.trace(normal_matrix, axis1=1, axis2=2)
    normal_matrix = normal_matrix + damping[:, None, None] * np.eye(6, dtype=np.float32)
    return np.linalg.solve(normal_matrix, gradient)[..., 0]


def _exp(tangent: Floats) -> Floats:
    """Return small motions as (n, 4, 4): their rotation exactly, the translation as it is."""
    T = np.zeros((len(tangent), 4, 4), np.float32)
    T[:, :3, :3] = Rotation.from_rotvec(tangent[:, :3]).as_matrix()
    T[:, :3, 3] = tangent[:, 3:]
    T[:, 3, 3] = 1.0
    return T
