"""Whether two aligned views show the same surfaces, and how firmly these hold the pose."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof.types import Array, Params, Pose, Verification

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
        description="The same where registration started without a guess.",
    )
    max_rmse_m: float = Field(
        0.05,
        gt=0,
        description="Largest root mean square of point-to-plane residuals, in m.",
    )


def assess_registration(
    params: RegistrationQualityParams,
    T_match_query: Pose,
    residuals_m: Array,
    information: Array,
    *,
    overlap: float,
    guessed: bool,
    reason_against: str = "",
) -> Verification:
    """Judge an alignment by the points that it brings onto the match's surfaces.

    Parameters
    ----------
    params
        What is asked of it.
    T_match_query
        (4, 4) the alignment.
    residuals_m
        (M,) from points of the query to the match's surface, along its normal.
    information
        (6, 6) as ``Verification`` has it.
    overlap
        Share of the query's points that the match sees too.
    guessed
        Whether the alignment started from a guess; else more overlap is asked.
    reason_against
        What else there is against it, in words.
    """
    if len(residuals_m) == 0:
        return reject("no correspondences", T_match_query, overlap=overlap)
    rmse_m = float(np.sqrt(np.mean(residuals_m**2)))
    min_overlap = params.min_overlap if guessed else params.min_overlap_global
    reason = ""
    if overlap < min_overlap:
        reason = f"overlap {overlap:.2f} below {min_overlap:g}"
    elif reason_against:
        reason = reason_against
    elif rmse_m > params.max_rmse_m:
        reason = f"residual {rmse_m:.3f} m above {params.max_rmse_m:g} m"
    return Verification(not reason, reason, T_match_query, overlap, rmse_m, information)


def reject(reason: str, T_match_query: Pose, *, overlap: float = 0.0) -> Verification:
    """Return that a pair was not aligned, and why."""
    return Verification(False, reason, T_match_query, overlap, float("inf"), np.zeros((6, 6)))
