"""Parameters of the search for loop candidates."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slam_bof.places import RecogniserParams
from slam_bof.types import Params

__all__ = ["LoopParams"]


class LoopParams(Params):
    """Parameters of the paper (Table 10), and those that this package adds."""

    by: Literal["views", "bags"] = Field(
        "views",
        description="What proposes loops: place recognition by depth views, or by bags of words as "
        "in the paper.",
    )
    upper_threshold: float | None = Field(
        None,
        ge=0,
        description="With bags: a candidate with eta above this is accepted without geometric "
        "verification; null verifies all.",
    )
    lower_threshold: float = Field(
        0.4,
        ge=0,
        description="With bags: a candidate with eta below this is discarded.",
    )
    normaliser_lag_s: float = Field(
        1.0,
        gt=0,
        description="With bags: age of the keyframe whose score normalises the others, in s (N or "
        "tau in the paper).",
    )
    min_normaliser: float = Field(
        0.05,
        ge=0,
        description="With bags: candidates of a keyframe whose normalising score is below this are "
        "rejected.",
    )
    min_inlier_ratio: float = Field(
        0.4,
        ge=0,
        le=1,
        description="With views: smallest inlier ratio, the share of points that both views see.",
    )
    recogniser: RecogniserParams = RecogniserParams()
    revisit_distance_m: float = Field(
        0.2,
        ge=0,
        description="With views: a keyframe with a loop to an older one closer than this, in m, is "
        "not searched for later.",
    )
    revisit_angle_rad: float = Field(
        0.2,
        ge=0,
        description="With views: largest angle to that older keyframe, in rad, for this.",
    )
    tc: int = Field(
        3,
        ge=0,
        description="Number of keyframes before this one that the check of time consistency looks "
        "at (TC in the paper).",
    )
    tc_required: int = Field(
        1,
        ge=0,
        description="How many of these must have a candidate near this one (TC_req in the paper).",
    )
    max_index_difference: int = Field(
        3,
        ge=0,
        description="Largest difference of keyframe numbers at which two candidates count as near.",
    )
    top_k: int = Field(
        3,
        gt=0,
        description="Largest number of candidates for a keyframe; the paper takes 1.",
    )
    min_age_s: float = Field(
        3.0,
        ge=0,
        description="Keyframes younger than this, in s, are no loop candidates.",
    )
    min_scene_agreement: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Smallest agreement of scene labels (Bhattacharyya coefficient); below it a "
        "candidate is rejected.",
    )
