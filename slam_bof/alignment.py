"""Align one view with many at once, and measure how far they agree.

A pose is good where the points of either view, seen from the other, lie at the depth that the
other has there: *seen* by it. Points that would stand in front of what it sees contradict:
*blocking*. First a random search about starting poses, scored by few points; then point-to-plane
ICP with projective association (Blais and Levine 1995), all pairs in one batch.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof import se3
from slam_bof.stack import Stack
from slam_bof.types import Array, Intrinsics, Params
from slam_bof.views import View

__all__ = ["Agreement", "AlignmentParams", "SurfacePairs", "ViewAligner"]

Indices = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]

ORBIT_M = 2.0
"""Half the random motions turn about a point so far ahead, at which the camera keeps looking."""
MIN_COSINE = 0.6
"""Between the normals of points that match."""

NEAR_M = np.float32(0.05)
"""Nearer than this, points are not projected."""
NORMAL_STEPS = 127
"""A normal is kept in bytes, each coordinate in so many steps."""


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
    n_fine_iterations: int = Field(4, ge=0, description="of which the last look at all points")
    n_coarse_points: int = Field(400, gt=0, description="that the others look at")
    gates_m: tuple[float, float] = Field((0.3, 0.1), description="of ICP, first and last")
    tolerance: tuple[float, float] = Field((0.05, 0.02), description="m, and share of depth")


class Agreement(NamedTuple):
    """How far a view agrees with others, each (n,)."""

    seen: Floats
    """Share of a view's points that the other sees too; the smaller of both ways."""
    blocking: Floats
    """Share of its points that would block what the other sees; both ways added."""


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
        self._seed = seed
        self._camera: Intrinsics | None = None
        self._rays: NDArray[np.float32]
        self._depths_m: Stack
        self._normals: Stack
        self._sampled: Stack
        self._surface: Stack
        self._order: Indices
        self._motions = _random_motions(params, seed)

    def add(self, view: View) -> None:
        """Hold another view; ids count from 0.

        Raises
        ------
        ValueError
            If it is of another camera than the views before.
        """
        p = self.params
        if self._camera is None:
            n_pixels = view.depth_m.size
            self._camera = view.intrinsics
            self._rays = view.rays().reshape(-1, 3)
            self._depths_m = Stack((n_pixels,), np.float32)
            self._normals = Stack((n_pixels, 3), np.int8)
            self._sampled = Stack((p.n_points,), np.int32)
            self._surface = Stack((p.n_points,), np.int32)
            self._order = np.random.default_rng(self._seed).permutation(n_pixels)
        if view.intrinsics != self._camera:
            raise ValueError(f"views must be of {self._camera}, got {view.intrinsics}")
        normals = view.normals_camera.reshape(-1, 3)
        self._depths_m.append(view.depth_m.reshape(-1))
        self._normals.append(np.rint(normals * NORMAL_STEPS))
        self._sampled.append(self._sample(np.flatnonzero(view.depth_m)))
        self._surface.append(self._sample(np.flatnonzero(normals.any(axis=1))))

    @property
    def nbytes(self) -> int:
        """Bytes of all views held."""
        if self._camera is None:
            return 0
        stacks = (self._depths_m, self._normals, self._sampled, self._surface)
        return sum(stack.rows.nbytes for stack in stacks)

    def points_camera(self, view_id: int) -> NDArray[np.float32]:
        """Return the points (N, 3) of a view."""
        depth_m = self._depths_m.rows[view_id]
        return np.asarray((self._rays * depth_m[:, None])[depth_m > 0])

    def align(self, query: int, matches: Indices, starts: Array) -> Array:
        """Return ``T_match_query`` (n, 4, 4) that fit best, from starts (n, S, 4, 4)."""
        return self.refine(query, matches, self._search(query, matches, starts.astype(np.float32)))

    def refine(self, query: int, matches: Indices, T_match_query: Floats) -> Array:
        """Return ``T_match_query`` (n, 4, 4) as point-to-plane ICP has them, all in one batch."""
        p = self.params
        T: Floats = T_match_query.astype(np.float32)
        for k, gate in enumerate(np.geomspace(*p.gates_m, p.n_iterations).astype(np.float32)):
            fine = k >= p.n_iterations - p.n_fine_iterations
            found = self._associate(query, matches, T, gate, None if fine else p.n_coarse_points)
            T = _exp(_step(found, gate)) @ T
        return T.astype(np.float64)

    def surface_pairs(
        self, query: int, matches: Indices, T_match_query: Array
    ) -> list[SurfacePairs]:
        """Return what the query sees of each match's surfaces, within the last gate.

        That is at poses (n, 4, 4).
        """
        found = self._associate(
            query, matches, T_match_query.astype(np.float32), np.float32(self.params.gates_m[-1])
        )
        points = self._points(query, self._surface.rows[query]).astype(np.float64)
        pairs = []
        for k, matched in enumerate(found.matched):
            R_match_query = T_match_query[k, :3, :3]
            normals = found.normals[k][:, matched].T @ R_match_query
            residuals_m = found.residuals_m[k][matched].astype(np.float64)
            pairs.append(SurfacePairs(points[matched], normals, residuals_m))
        return pairs

    def seen(self, query: int, matches: Indices, T_match_query: Array) -> tuple[Floats, Floats]:
        """Return the shares (n,) of the query's points that each match sees, and that block it."""
        points = self._points(query, self._sampled.rows[query])
        return self._shares(points, matches, T_match_query.astype(np.float32))

    def agreement(self, query: int, matches: Indices, T_match_query: Array) -> Agreement:
        """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
        T = T_match_query.astype(np.float32)
        points = self._points(query, self._sampled.rows[query])
        seen, blocking = self._shares(points, matches, T)
        own = self._points(matches[:, None], self._sampled.rows[matches])
        back = se3.inverse(T_match_query).astype(np.float32)
        seen_back, blocking_back = self._shares(own, np.full(len(matches), query), back)
        return Agreement(np.minimum(seen, seen_back), blocking + blocking_back)

    # ``take`` from flat arrays is three times as fast as indexing by views and pixels.

    def _depth(self, views: int | Indices, pixels: Indices) -> Floats:
        flat = self._depths_m.rows.reshape(-1)
        return np.asarray(flat.take(views * len(self._rays) + pixels))

    def _points(self, views: int | Indices, pixels: Indices) -> Floats:
        return np.asarray(self._rays.take(pixels, axis=0) * self._depth(views, pixels)[..., None])

    def _normal(self, views: int | Indices, pixels: Indices) -> Floats:
        flat = self._normals.rows.reshape(-1, 3)
        found = flat.take(views * len(self._rays) + pixels, axis=0)
        return np.asarray(found * np.float32(1.0 / NORMAL_STEPS))

    def _sample(self, pixels: Indices) -> Indices:
        """Return ``n_points`` of these, some twice where they are few, or else just any."""
        chosen = self._order[np.isin(self._order, pixels)]
        return np.resize(chosen if len(chosen) else self._order, self.params.n_points)

    def _search(self, query: int, matches: Indices, starts: Floats) -> Floats:
        """Return the best of random poses about the starts, in rounds of smaller motions."""
        p = self.params
        pixels = self._sampled.rows[query, : p.n_search_points]
        points = self._points(query, pixels)
        tolerance = np.array(p.search_tolerance, np.float32)
        for motions in self._motions:
            tried = np.matmul(motions, starts[:, :, None]).reshape(len(starts), -1, 4, 4)
            scores = self._score(points, matches, tried, tolerance)
            best = np.argsort(-scores, axis=1, kind="stable")[:, :2]
            starts = np.take_along_axis(tried, best[..., None, None], axis=1)
            tolerance = tolerance * np.float32(0.7)
        return starts[:, 0]

    def _score(self, points: Floats, matches: Indices, poses: Floats, tolerance: Floats) -> Floats:
        """Score poses (n, P, 4, 4): points at the depth that is there count, blocking ones cost."""
        n, n_poses = poses.shape[:2]
        rotated = poses[..., :3, :3].reshape(n, -1, 3) @ points.T
        moved = rotated.reshape(n, n_poses, 3, -1) + poses[..., :3, 3:]
        depth = moved[:, :, 2]
        column, row, inside = self._project(moved[:, :, 0], moved[:, :, 1], depth)
        pixels = self._pixel(matches[:, None, None], column, row, inside)
        there = self._depths_m.rows.reshape(-1).take(pixels)
        off = depth - there
        allowed = tolerance[0] + tolerance[1] * there
        worth = np.maximum(1.0 - np.abs(off) / allowed, 0.0) - 0.5 * (off < -allowed)
        return np.asarray(np.where(inside & (there > 0), worth, 0.0).mean(axis=-1))

    def _associate(
        self,
        query: int,
        matches: Indices,
        T: Floats,
        gate_m: np.float32,
        n_points: int | None = None,
    ) -> _Association:
        """Pair the query's surface points with what the others see at the pixels they fall on."""
        camera = self._camera
        assert camera is not None
        pixels = self._surface.rows[query, :n_points]
        points = _rotate(T, self._points(query, pixels)) + T[:, :3, 3:]
        facing = _rotate(T, self._normal(query, pixels))
        column, row, inside = self._project(*np.moveaxis(points, 1, 0))
        there = self._pixel(matches[:, None], column, row, inside)
        depth = self._depths_m.rows.reshape(-1).take(there)
        bytes_ = self._normals.rows.reshape(-1, 3).take(there, axis=0)
        normals = np.empty_like(points)
        np.multiply(np.moveaxis(bytes_, -1, 1), np.float32(1.0 / NORMAL_STEPS), out=normals)
        column -= np.float32(camera.cx)
        column *= np.float32(1.0 / camera.fx)
        row -= np.float32(camera.cy)
        row *= np.float32(1.0 / camera.fy)
        gap = np.empty_like(points)
        np.multiply(column, depth, out=gap[:, 0])
        np.multiply(row, depth, out=gap[:, 1])
        gap[:, 2] = depth
        gap -= points
        residuals_m = _dot(gap, normals)
        matched = (
            inside
            & (_dot(gap, gap) < 4.0 * gate_m**2)
            & (np.abs(residuals_m) < gate_m)
            & (_dot(normals, facing) > MIN_COSINE)
        )
        return _Association(points, normals, residuals_m, matched)

    def _shares(self, points: Floats, frames: Indices, T: Floats) -> tuple[Floats, Floats]:
        """Return the shares of points that the frames see, and that block what they see."""
        moved = points @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        column, row, inside = self._project(*np.moveaxis(moved, -1, 0))
        pixels = self._pixel(frames[:, None], column, row, inside)
        there = self._depths_m.rows.reshape(-1).take(pixels)
        inside &= there > 0
        off = moved[..., 2] - there
        fixed, share = self.params.tolerance
        allowed = fixed + share * moved[..., 2]
        return (inside & (np.abs(off) < allowed)).mean(axis=1), (inside & (off < -allowed)).mean(
            axis=1
        )

    def _project(self, x: Floats, y: Floats, z: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
        """Return the column and row that points fall on, and whether those are in the image."""
        camera = self._camera
        assert camera is not None
        inverse = np.maximum(z, NEAR_M)
        np.divide(np.float32(1.0), inverse, out=inverse)
        column, row = x * inverse, y * inverse
        for along, focal, centre in (
            (column, camera.fx, camera.cx),
            (row, camera.fy, camera.cy),
        ):
            along *= np.float32(focal)
            along += np.float32(centre)
            np.rint(along, out=along)
        inside = (z > NEAR_M) & (column >= 0) & (column < camera.width)
        inside &= (row >= 0) & (row < camera.height)
        return column, row, inside

    def _pixel(
        self, views: int | Indices, column: Floats, row: Floats, inside: NDArray[np.bool_]
    ) -> Indices:
        """Return where in the flat arrays of all views a pixel is; that of 0 if outside."""
        assert self._camera is not None
        pixels = row * np.float32(self._camera.width)
        pixels += column
        pixels *= inside
        return pixels.astype(np.intp) + views * len(self._rays)


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
    x, y, z = np.moveaxis(points, 1, 0)
    a, b, c = np.moveaxis(normals, 1, 0)
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
    T = se3.exp(np.pad(tangent[:, :3], ((0, 0), (0, 3))))
    T[:, :3, 3] = tangent[:, 3:]
    return T.astype(np.float32)
