"""The options that KISS-ICP and GenZ-ICP share."""

from __future__ import annotations

from pydantic import Field

from slam_bof.types import Params

__all__ = ["IcpParams"]


class IcpParams(Params):
    """Parameters of ICP against a voxel map with an adaptive correspondence distance."""

    voxel_size_m: float = Field(0.06, gt=0, description="Side of the map's voxels in metres.")
    max_points_per_voxel: int = Field(
        1, gt=0, description="Largest number of points that a voxel of the map keeps."
    )
    initial_threshold_m: float = Field(
        0.1, gt=0, description="Initial correspondence distance in metres."
    )
    min_motion_m: float = Field(
        0.015, gt=0, description="Least motion in metres that adapts the correspondence distance."
    )
    max_iterations: int = Field(100, gt=0, description="Largest number of ICP iterations.")
    convergence: float = Field(
        1e-4, gt=0, description="ICP stops when the norm of a step (rad and m) is below this."
    )
    min_points: int = Field(
        100, gt=0, description="A frame with fewer points repeats the last pose."
    )
