"""Geometric verification of depth images: point-to-plane ICP with projective association.

A point's match is what the other image shows at the pixel it falls on (Blais and Levine 1995),
which takes no search tree. Without a guess, random poses about the same
view are tried first: that is for views found alike, not for any two.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof.alignment import AlignmentParams, ViewAligner
from slam_bof.types import Array, DepthFrame, Params, Pose, Verification
from slam_bof.views import make_view

__all__ = ["ProjectiveParams", "ProjectiveVerifier"]


class ProjectiveParams(Params):
    """What two views of the same surfaces must have in common."""

    alignment: AlignmentParams = AlignmentParams(
        n_points=3000, n_iterations=15, gates_m=(0.3, 0.03)
    )
    min_overlap: float = Field(0.35, ge=0, le=1)
    min_overlap_global: float = Field(0.6, ge=0, le=1, description="where no guess was given")
    max_blocking: float = Field(0.15, ge=0, le=1, description="before what the other sees")
    max_rmse_m: float = Field(0.05, gt=0)
    min_stiffness: float = Field(
        0.002, ge=0, description="least eigenvalue of the information per point"
    )


class ProjectiveVerifier:
    """Keeps small views, aligns two of them, and judges whether they show the same surfaces."""

    Params = ProjectiveParams

    def __init__(self, params: ProjectiveParams | None = None) -> None:
        self.params = params or ProjectiveParams()
        self._aligner = ViewAligner(self.params.alignment)
        self._n_views = 0

    def prepare(self, frame: DepthFrame, points_camera: Array) -> int:
        """Keep a small view of the frame; return its number."""
        view, _ = make_view(frame)
        self._aligner.add(view)
        self._n_views += 1
        return self._n_views - 1

    def verify(
        self, query: int, match: int, *, T_match_query: Pose | None = None, seed: int = 0
    ) -> Verification:
        """Align ``query`` with ``match`` from the guess or, without one, from standing still."""
        p = self.params
        matches = np.array([match])
        if T_match_query is None:
            min_overlap = p.min_overlap_global
            T = self._aligner.align(query, matches, np.eye(4)[None, None])[0]
        else:
            min_overlap = p.min_overlap
            T = self._aligner.refine(query, matches, T_match_query[None])[0]
        overlap, blocking = self._aligner.seen(query, match, T)
        pairs = self._aligner.surface_pairs(query, match, T)
        if len(pairs.residuals_m) == 0:
            return Verification(
                False, "no surface in common", T, overlap, float("inf"), np.zeros((6, 6))
            )
        rmse_m = float(np.sqrt(np.mean(pairs.residuals_m**2)))
        points, normals = pairs.points_query, pairs.normals_query
        jacobian = np.hstack([np.cross(points, normals), normals]).astype(np.float64)
        information = jacobian.T @ jacobian
        stiffness = float(np.linalg.eigvalsh(information)[0]) / len(points)
        if overlap < min_overlap:
            reason = f"overlap {overlap:.2f} below {min_overlap:g}"
        elif blocking > p.max_blocking:
            reason = f"{blocking:.2f} of the points stand before what the other sees"
        elif rmse_m > p.max_rmse_m:
            reason = f"residual {rmse_m:.3f} m above {p.max_rmse_m:g} m"
        elif stiffness < p.min_stiffness:
            reason = f"degenerate: stiffness {stiffness:.4f} below {p.min_stiffness:g}"
        else:
            reason = ""
        return Verification(not reason, reason, T, overlap, rmse_m, information)
