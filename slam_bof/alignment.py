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
from slam_bof.types import Array, Intrinsics, Params, Pose
from slam_bof.views import View

__all__ = ["Agreement", "AlignmentParams", "SurfacePairs", "ViewAligner"]

Indices = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]

ORBIT_M = 2.0
"""Half the random motions turn about a point so far ahead, at which the camera keeps looking."""
MIN_COSINE = 0.6
"""Between the normals of points that match."""

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
    gates_m: tuple[float, float] = Field((0.3, 0.1), description="of ICP, first and last")
    tolerance: tuple[float, float] = Field((0.05, 0.02), description="m, and share of depth")


class Agreement(NamedTuple):
    """How far a view agrees with others, each (n,)."""

    seen: Floats
    """Share of a view's points that the other sees too; the smaller of both ways."""
    blocking: Floats
    """Share of its points that would block what the other sees; both ways added."""
    compared: Floats
    """Share of its points that fall where the other has a depth at all; the smaller."""


class SurfacePairs(NamedTuple):
    """Points of a query that lie on a surface of the match, all in the query's camera frame."""

    points_query: Floats
    """(M, 3)."""
    normals_query: Floats
    """(M, 3), of the match's surface."""
    residuals_m: Floats
    """(M,) from the point to the surface, along the normal."""


class _Association(NamedTuple):
    """For n matches and m points: points and normals (n, m, 3) in the matches' frames."""

    points: Floats
    normals: Floats
    residuals_m: Floats
    matched: NDArray[np.bool_]


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

    def __len__(self) -> int:
        """Return the number of views held."""
        return 0 if self._camera is None else len(self._depths_m)

    def truncate(self, n: int) -> None:
        """Hold only the first ``n`` views."""
        if self._camera is not None:
            for stack in (self._depths_m, self._normals, self._sampled, self._surface):
                stack.truncate(n)

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
        for gate in np.geomspace(*p.gates_m, p.n_iterations).tolist():
            found = self._associate(query, matches, T, gate)
            # Geman-McClure, and less for what is far, whose depth is less sure.
            robust = (1.0 + (2.0 * found.residuals_m / gate) ** 2) ** -2
            weight = np.where(found.matched, robust / (0.2 + 0.2 * found.points[..., 2] ** 2), 0.0)
            turn = np.cross(found.points, found.normals)
            T = _exp(_solve(turn, found.normals, found.residuals_m, weight)) @ T
        return T.astype(np.float64)

    def surface_pairs(self, query: int, match: int, T_match_query: Pose) -> SurfacePairs:
        """Return what the two see of the same surfaces at a pose (4, 4), within the last gate."""
        T = T_match_query[None].astype(np.float32)
        found = self._associate(query, np.array([match]), T, self.params.gates_m[-1])
        matched = found.matched[0]
        pixels = self._surface.rows[query][matched]
        R_query_match = T_match_query[:3, :3].T
        return SurfacePairs(
            self._points(query, pixels),
            found.normals[0][matched] @ R_query_match.T,
            found.residuals_m[0][matched],
        )

    def seen(self, query: int, match: int, T_match_query: Pose) -> tuple[float, float]:
        """Return the shares of the query's points that the match sees, and that block it."""
        points = self._points(query, self._sampled.rows[query])
        T = T_match_query[None].astype(np.float32)
        seen, blocking, _ = self._shares(points, np.array([match]), T)
        return float(seen[0]), float(blocking[0])

    def agreement(self, query: int, matches: Indices, T_match_query: Array) -> Agreement:
        """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
        T = T_match_query.astype(np.float32)
        points = self._points(query, self._sampled.rows[query])
        seen, blocking, compared = self._shares(points, matches, T)
        own = self._points(matches[:, None], self._sampled.rows[matches])
        back = se3.inverse(T_match_query).astype(np.float32)
        seen_back, blocking_back, compared_back = self._shares(
            own, np.full(len(matches), query), back
        )
        return Agreement(
            np.minimum(seen, seen_back),
            blocking + blocking_back,
            np.minimum(compared, compared_back),
        )

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
        pixels, inside = self._project(moved[:, :, 0], moved[:, :, 1], depth)
        there = self._depth(matches[:, None, None], pixels)
        off = depth - there
        allowed = tolerance[0] + tolerance[1] * there
        worth = np.maximum(1.0 - np.abs(off) / allowed, 0.0) - 0.5 * (off < -allowed)
        return np.asarray(np.where(inside & (there > 0), worth, 0.0).mean(axis=-1))

    def _associate(self, query: int, matches: Indices, T: Floats, gate_m: float) -> _Association:
        """Pair the query's surface points with what the others see at the pixels they fall on."""
        pixels = self._surface.rows[query]
        R_t = T[:, :3, :3].transpose(0, 2, 1)
        moved = self._points(query, pixels) @ R_t + T[:, None, :3, 3]
        fallen, inside = self._project(*np.moveaxis(moved, -1, 0))
        gap = self._points(matches[:, None], fallen) - moved
        normals = self._normal(matches[:, None], fallen)
        residuals_m = _dot(gap, normals)
        matched = (
            inside
            & (_dot(gap, gap) < 4.0 * gate_m**2)
            & (np.abs(residuals_m) < gate_m)
            & (_dot(normals, self._normal(query, pixels) @ R_t) > MIN_COSINE)
        )
        return _Association(moved, normals, residuals_m, matched)

    def _shares(self, points: Floats, frames: Indices, T: Floats) -> tuple[Floats, Floats, Floats]:
        """Return the shares of points that the frames see, that block, and that can be told."""
        moved = points @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        pixels, inside = self._project(*np.moveaxis(moved, -1, 0))
        there = self._depth(frames[:, None], pixels)
        inside &= there > 0
        off = moved[..., 2] - there
        fixed, share = self.params.tolerance
        allowed = fixed + share * moved[..., 2]
        seen, blocking = inside & (np.abs(off) < allowed), inside & (off < -allowed)
        return seen.mean(axis=1), blocking.mean(axis=1), inside.mean(axis=1)

    def _project(self, x: Floats, y: Floats, z: Floats) -> tuple[Indices, NDArray[np.bool_]]:
        """Return the pixels that points fall on, and whether they are in the image at all."""
        camera = self._camera
        assert camera is not None
        inverse = np.float32(1.0) / np.maximum(z, np.float32(0.05))
        column = np.rint(x * inverse * np.float32(camera.fx) + np.float32(camera.cx))
        row = np.rint(y * inverse * np.float32(camera.fy) + np.float32(camera.cy))
        inside = (
            (z > 0.05)
            & (column >= 0)
            & (column < camera.width)
            & (row >= 0)
            & (row < camera.height)
        )
        return np.where(inside, row * camera.width + column, 0).astype(np.intp), inside


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


def _dot(a: Floats, b: Floats) -> Floats:
    """Return the dot products (...) of vectors (..., 3)."""
    return np.asarray(np.einsum("...i,...i->...", a, b))


def _solve(turn: Floats, push: Floats, residual: Floats, weight: Floats) -> Floats:
    """Return the small motions (n, 6), rotation first, of damped weighted least squares."""
    jacobian = np.concatenate([turn, push], axis=-1)
    weighted = (jacobian * weight[..., None]).transpose(0, 2, 1)
    normal_matrix = weighted @ jacobian
    gradient = weighted @ residual[..., None]
    # What the surfaces leave open stays as it is.
    damping = 1e-3 + 0.0005 * np.trace(normal_matrix, axis1=1, axis2=2)
    normal_matrix += damping[:, None, None] * np.eye(6, dtype=np.float32)
    return np.linalg.solve(normal_matrix, gradient)[..., 0]


def _exp(tangent: Floats) -> Floats:
    """Return small motions as (n, 4, 4): their rotation exactly, the translation as it is."""
    T = se3.exp(np.pad(tangent[:, :3], ((0, 0), (0, 3))))
    T[:, :3, 3] = tangent[:, 3:]
    return T.astype(np.float32)
