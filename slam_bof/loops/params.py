"""Parameters of the search for loop candidates."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from slam_bof.places import RecogniserParams
from slam_bof.types import Params

__all__ = ["LoopParams"]


class LoopParams(Params):
    """The parameters of Table 10, and what the product adds to them."""

    by: Literal["views", "bags"] = "views"
    upper_threshold: float | None = Field(
        None, ge=0, description="bags: eta above it: accepted unverified; null: all are verified"
    )
    lower_threshold: float = Field(0.4, ge=0, description="bags: eta below it: discarded")
    normaliser_lag_s: float = Field(1.0, gt=0, description="bags: N, or tau, as a time")
    min_normaliser: float = Field(0.05, ge=0, description="bags: below it not judged")
    min_seen: float = Field(0.4, ge=0, le=1, description="views: share of points both see")
    recogniser: RecogniserParams = RecogniserParams()
    repeat_m: float = Field(0.2, ge=0, description="views: who has a loop to nearer than this")
    repeat_rad: float = Field(0.2, ge=0, description="and turned by less is not searched for")
    tc: int = Field(3, ge=0, description="keyframes that the time consistency check runs over")
    tc_required: int = Field(1, ge=0, description="of which so many must agree")
    max_index_difference: int = Field(3, ge=0, description="keyframes apart that still agree")
    top_k: int = Field(3, gt=0, description="candidates a keyframe; 1 in the paper")
    min_age_s: float = Field(3.0, ge=0, description="younger keyframes are not loops")
    min_scene_agreement: float = Field(0.2, ge=0, le=1, description="below it labels contradict")
