"""Parameters of tracking."""

from __future__ import annotations

from pydantic import Field

from slam_bof.geometry import AlignmentParams
from slam_bof.types import Params

__all__ = ["TrackingParams"]


class TrackingParams(Params):
    """What a frame must have in common with the keyframe, or with the frame before.

    Of the points that fall where the other view has a depth, agreement is the share that lies at
    that depth. A wrong pose in the same room may reach 0.7; what a right one has depends on the
    sensor (a structured-light camera 0.95, a stereo camera 0.8), so it is held against what is
    usual.
    """

    enabled: bool = Field(
        True,
        description="Whether frames are tracked; without, odometry is taken as it is.",
    )
    alignment: AlignmentParams = AlignmentParams(
        n_points=1000, n_iterations=8, gates_m=(0.15, 0.03)
    )
    max_inlier_drop: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Largest drop of the inlier ratio below its running mean at which a frame "
        "still counts as tracked.",
    )
    max_inlier_drop_relocalised: float = Field(
        0.1,
        ge=0,
        le=1,
        description="The same for a frame whose pose had to be searched for.",
    )
    min_visible_ratio: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Smallest share of points that fall where the other view has a depth.",
    )
    min_visible_ratio_relocalised: float = Field(
        0.4,
        ge=0,
        le=1,
        description="The same for a frame whose pose had to be searched for.",
    )
    min_surface_ratio: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Smallest share of the points that must meet a surface of the other view; with "
        "fewer, an alignment may agree by chance, and the pose is that of odometry.",
    )
    max_score_drop: float = Field(
        0.02,
        ge=0,
        description="Largest drop of the agreement score below its running mean at which no other "
        "starts are tried.",
    )
    max_score_drop_relocalised: float = Field(
        0.2,
        ge=0,
        description="Largest drop of the agreement score below its running mean for a frame whose "
        "pose had to be searched for.",
    )
    max_free_space_violation: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Largest share of points in front of what the other view sees, above its "
        "running mean, at which odometry is believed although the views do not agree.",
    )
    min_valid_pixel_ratio: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Smallest share of pixels with a depth.",
    )
