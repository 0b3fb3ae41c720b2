"""Whether two aligned views show the same surfaces, and how well these determine the pose."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof.geometry.projective_icp import SurfacePairs
from slam_bof.types import Params, Pose, Verification

__all__ = ["RegistrationQualityParams", "assess_registration", "reject"]


class RegistrationQualityParams(Params):
    """What two views of the same surfaces must have in common."""

    min_overlap: float = Field(
        0.35,
        ge=0,
        le=1,
        description="Smallest share of points with a match.",
    )
    min_overlap_global: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Smallest share of points with a match where registration started without a "
        "guess.",
    )
    max_rmse_m: float = Field(
        0.05,
        gt=0,
        description="Largest root mean square of point-to-plane residuals, in m.",
    )
    min_stiffness: float = Field(
        0.0005,
        ge=0,
        description="Smallest eigenvalue of the information for each point, in m^2 and rad^2; the "
        "noise of normals does not count where those of both views are known.",
    )


def assess_registration(
    params: RegistrationQualityParams,
    T_match_query: Pose,
    pairs: SurfacePairs,
    *,
    overlap: float,
    guessed: bool,
    reason_against: str = "",
) -> Verification:
    """Accept or reject an alignment by the points that it brings onto the match's surfaces.

    Parameters
    ----------
    params
        What it needs.
    T_match_query
        (4, 4) the alignment.
    pairs
        The points that lie on surfaces of the match. The noise of normals does not count as
        stiffness, since that of the query's own surfaces is independent of that of the match's;
        where the query's are not known, ``facing_query`` are the match's as well.
    overlap
        Share of the query's points that are inliers in the match.
    guessed
        Whether the alignment started from a guess; otherwise it needs more overlap.
    reason_against
        Another reason to reject it; empty if there is none.
    """
    points, normals, facing, residuals_m = pairs
    if len(residuals_m) == 0:
        return reject("no correspondences", T_match_query, overlap=overlap)
    rmse_m = float(np.sqrt(np.mean(residuals_m**2)))
    jacobian = np.hstack([np.cross(points, normals), normals])
    information = jacobian.T @ jacobian
    cross = np.hstack([np.cross(points, facing), facing]).T @ jacobian
    least = np.linalg.eigvalsh(0.5 * (cross + cross.T))[0]
    stiffness = max(float(least), 0.0) / len(residuals_m)  # noise may be less than nothing
    min_overlap = params.min_overlap if guessed else params.min_overlap_global
    reason = ""
    if overlap < min_overlap:
        reason = f"overlap {overlap:.2f} below {min_overlap:g}"
    elif reason_against:
        reason = reason_against
    elif rmse_m > params.max_rmse_m:
        reason = f"residual {rmse_m:.3f} m above {params.max_rmse_m:g} m"
    elif stiffness < params.min_stiffness:
        reason = f"degenerate: stiffness {stiffness:.4f} below {params.min_stiffness:g}"
    return Verification(not reason, reason, T_match_query, overlap, rmse_m, information)


def reject(reason: str, T_match_query: Pose, *, overlap: float = 0.0) -> Verification:
    """Return that a pair was not aligned, and why."""
    return Verification(False, reason, T_match_query, overlap, float("inf"), np.zeros((6, 6)))
