"""Parameters of place recognition."""

from __future__ import annotations

from pydantic import Field

from slam_bof.bof import ConstellationParams, IndexParams
from slam_bof.geometry import AlignmentParams, GravityParams
from slam_bof.types import Params

__all__ = ["RecogniserParams"]


class RecogniserParams(Params):
    """Parameters of place recognition: sizes of the shortlists, and ranking of alignments."""

    n_aligned: int = Field(
        20,
        ge=0,
        description="Number of views that are aligned with the query.",
    )
    n_followed: int = Field(
        5,
        ge=0,
        description="Number of matches of the last view that are followed by odometry.",
    )
    n_neighbours: int = Field(
        2,
        ge=0,
        description="Number of views before and after such a match that are tried too.",
    )
    overlap_saturation: float = Field(
        0.55,
        ge=0,
        description="Inlier ratio, less free-space violations, above which a higher one hardly "
        "counts.",
    )
    near_bonus: float = Field(
        0.1,
        ge=0,
        description="Largest bonus in the score for a view from the same viewpoint.",
    )
    near_m: float = Field(
        0.3,
        gt=0,
        description="Distance between viewpoints at which that bonus falls off, in m.",
    )
    near_deg: float = Field(
        25.0,
        gt=0,
        description="Angle between viewpoints at which that bonus falls off, in degrees.",
    )
    constellation: ConstellationParams = ConstellationParams()
    gravity: GravityParams = GravityParams()
    search: IndexParams = IndexParams()
    alignment: AlignmentParams = AlignmentParams(n_rounds=0)
