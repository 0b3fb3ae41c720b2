"""Align one view with many at once, and measure how far they agree.

At a good pose the points of either view lie at the depth that the other view has there: they are
inliers. Points in front of what the other view sees violate its free space. A random search about
starting poses, scored by few points, is followed by point-to-plane ICP with projective association
(Blais and Levine 1995). All pairs are in one batch, with few points until they are close.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.geometry.depth_view import DepthView
from slam_bof.geometry.point_to_plane import IcpSchedule, associate, refine
from slam_bof.geometry.pose_scores import (
    AgreementScore,
    agreement_score,
    rough_score,
    score_poses,
)
from slam_bof.geometry.view_stack import Floats, Indices, ViewStack
from slam_bof.geometry.visibility import (
    Agreement,
    Coverage,
    agreement,
    classify_points,
    coverage,
)
from slam_bof.types import Array, Params

__all__ = ["AlignmentParams", "SurfacePairs", "ViewAligner"]

ORBIT_M = 2.0
"""Half of the random motions turn about a point this far ahead, so that it stays in view."""


class AlignmentParams(Params):
    """How hard a pose is searched for, and which points count as inliers."""

    n_points: int = Field(
        400,
        gt=0,
        description="Number of points of a view that ICP and agreement use.",
    )
    n_search_points: int = Field(
        100,
        gt=0,
        description="Number of points that score a random pose.",
    )
    n_poses: int = Field(
        32,
        gt=0,
        description="Number of random poses around each start in a round.",
    )
    n_rounds: int = Field(
        3,
        ge=0,
        description="Number of rounds, each around the two best poses with half the spread. "
        "Without any, alignment begins at the first start of each pair.",
    )
    sigma_deg: tuple[float, float, float] = Field(
        (6.0, 7.0, 5.0),
        description="Standard deviations of random rotations about x, y and z, in degrees.",
    )
    sigma_m: tuple[float, float, float] = Field(
        (0.25, 0.15, 0.25),
        description="Standard deviations of random translations along x, y and z, in m.",
    )
    search_tolerance: tuple[float, float] = Field(
        (0.1, 0.03),
        description="Depth difference that the search tolerates, in m and as a share of depth.",
    )
    n_iterations: int = Field(12, gt=0, description="Number of ICP iterations.")
    n_fine_iterations: int = Field(
        8,
        ge=0,
        description="Number of iterations at the end that use all points.",
    )
    n_coarse_points: int = Field(
        1000,
        gt=0,
        description="Number of points that the other iterations use.",
    )
    gates_m: tuple[float, float] = Field(
        (0.3, 0.1),
        description="Largest residual of a correspondence in the first and the last iteration, in "
        "m.",
    )
    min_step: float = Field(
        1e-3,
        ge=0,
        description="Pairs that move by less than this, in rad and m, rest until the last "
        "iterations.",
    )
    n_final_iterations: int = Field(
        2,
        ge=0,
        description="Number of iterations at the end in which all pairs move.",
    )
    tolerance: tuple[float, float] = Field(
        (0.05, 0.02),
        description="Depth difference at which a point counts as an inlier, in m and as a share of "
        "depth.",
    )


class SurfacePairs(NamedTuple):
    """Points of a query that lie on a surface of the match, all in the query's camera frame."""

    points_query: Array
    """(M, 3)."""
    normals_query: Array
    """(M, 3), of the match's surface."""
    facing_query: Array
    """(M, 3), of the query's own surface."""
    residuals_m: Array
    """(M,) from the point to the surface, along the normal."""


class ViewAligner:
    """Holds views of one camera, and aligns one of them with others."""

    def __init__(self, params: AlignmentParams, *, seed: int = 0) -> None:
        self.params = params
        self.views = ViewStack(params.n_points, seed=seed)
        self._motions = _random_motions(params, seed)
        is_fine = np.arange(params.n_iterations) >= params.n_iterations - params.n_fine_iterations
        n_coarse_points = min(params.n_points, params.n_coarse_points)
        self.schedule = IcpSchedule(
            np.geomspace(*params.gates_m, params.n_iterations),
            np.where(is_fine, params.n_points, n_coarse_points),
            params.min_step,
            params.n_final_iterations,
        )

    def add(self, view: DepthView) -> None:
        """Hold another view; ids count from 0.

        Raises
        ------
        ValueError
            If it is of another camera than the views before.
        """
        self.views.add(view)

    def __len__(self) -> int:
        """Return the number of views added so far, dropped ones included: the next id."""
        return len(self.views)

    def drop(self, view_id: int) -> None:
        """Drop a view; ``KeyError`` if none of that id is held."""
        self.views.drop(view_id)

    def truncate(self, n: int) -> None:
        """Hold only the views with ids below ``n``; the next id is ``n``."""
        self.views.truncate(n)

    @property
    def nbytes(self) -> int:
        """Bytes of all views held."""
        return self.views.nbytes

    def points_camera(self, view_id: int) -> NDArray[np.float32]:
        """Return the points (N, 3) of a view."""
        return self.views.points_camera(view_id)

    def sampled(self, view_id: int, n_points: int) -> Array:
        """Return ``n_points`` points (n, 3) of a view, ``params.n_points`` at most."""
        return self.views.sampled(view_id, n_points).astype(np.float64)

    def align(self, query: int, matches: Indices, starts: Array) -> Array:
        """Return ``T_match_query`` (n, 4, 4) that fit best, from starts (n, S, 4, 4)."""
        return self.refine(query, matches, self.search(query, matches, starts))

    def search(self, query: int, matches: Indices, starts: Array) -> Array:
        """Return the best (n, 4, 4) of random poses about starts (n, S, 4, 4).

        It takes rounds of smaller and smaller motions.
        """
        points = self.views.sampled(query, self.params.n_search_points)
        tolerance = np.array(self.params.search_tolerance)
        arrays, rows = self.views.arrays(), self.views.rows(matches)
        for motions in self._motions:
            tried = np.matmul(motions, starts[:, :, None]).reshape(len(starts), -1, 4, 4)
            scores = np.stack(
                [
                    score_poses(arrays, row, points, poses, tolerance)
                    for row, poses in zip(rows, tried, strict=True)
                ]
            )
            best = np.argsort(-scores, axis=1, kind="stable")[:, :2]
            starts = np.take_along_axis(tried, best[..., None, None], axis=1)
            tolerance = tolerance * 0.7
        return starts[:, 0]

    def rough_score(
        self, query: int, matches: Indices, T_match_query: Array, bonus: Array
    ) -> Floats:
        """Score poses (n, 4, 4) by few points, (n,): by those of the view that agrees less.

        A ``bonus`` (n,) is added. Of poses of one match that follow each other, those that cannot
        become the best any more are scored one way only, which may be too high, but not the best.
        """
        return rough_score(
            self.views,
            query,
            matches,
            T_match_query,
            bonus,
            self.params.n_search_points,
            self.params.search_tolerance,
        )

    def refine(self, query: int, matches: Indices, T_match_query: Array) -> Array:
        """Return ``T_match_query`` (n, 4, 4) after point-to-plane ICP from given ones.

        Pairs that have come to rest wait for the last iterations, whose gates are the narrowest.
        Starts are rounded to single precision: those that differ in the last digits, as in a map
        that was loaded again, end at the same pose.
        """
        return refine(
            self.views.arrays(),
            self.views.rows(matches),
            *self.views.surface(query),
            se3.nearest_pose(T_match_query.astype(np.float32)),
            self.schedule,
        )

    def surface_pairs(
        self, query: int, matches: Indices, T_match_query: Array
    ) -> list[SurfacePairs]:
        """Return what the query sees of each match's surfaces at poses (n, 4, 4).

        That is within the last gate.
        """
        arrays, rows = self.views.arrays(), self.views.rows(matches)
        surface = self.views.surface(query)
        points, facing = (a.astype(np.float64) for a in surface)
        found = np.empty((len(points), 10))
        pairs = []
        for row, T in zip(rows, T_match_query, strict=True):
            n, indices = associate(arrays, row, *surface, T, self.params.gates_m[-1], found)
            normals = found[:n, 6:9] @ T[:3, :3]
            pairs.append(
                SurfacePairs(points[indices], normals, facing[indices], found[:n, 9].copy())
            )
        return pairs

    def inlier_ratio(
        self, query: int, matches: Indices, T_match_query: Array
    ) -> tuple[Floats, Floats]:
        """Return the shares (n,) of the query's points that are inliers or violate free space."""
        points = self.views.sampled(query)
        tolerance = self.params.tolerance
        visibility = classify_points(self.views, points, matches, T_match_query, tolerance)
        return visibility.inlier.mean(axis=1), visibility.violating.mean(axis=1)

    def agreement(self, query: int, matches: Indices, T_match_query: Array) -> Agreement:
        """Measure how far the query agrees with each match (n,) at a pose (n, 4, 4)."""
        return agreement(self.views, query, matches, T_match_query, self.params.tolerance)

    def agreement_score(self, query: int, matches: Indices, T_match_query: Array) -> AgreementScore:
        """Score by how much the query agrees with each match (n,) at a pose (n, 4, 4)."""
        return agreement_score(self.views, query, matches, T_match_query)

    def coverage(self, query: int, matches: Indices, T_match_query: Array) -> Coverage:
        """Measure how far the query agrees with all matches (n,) together at poses (n, 4, 4)."""
        return coverage(self.views, query, matches, T_match_query, self.params.tolerance)


def _random_motions(params: AlignmentParams, seed: int) -> list[Array]:
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
        rounds.append(T)
    return rounds
