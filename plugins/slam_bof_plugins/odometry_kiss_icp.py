"""KISS-ICP (Vizzo et al., RA-L 2023) with a preset for indoor depth cameras."""

from __future__ import annotations

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP
from pydantic import Field

from slam_bof.geometry import back_project, se3
from slam_bof.types import DepthFrame, Pose
from slam_bof_plugins.odometry_icp import IcpParams

__all__ = ["KissIcpOdometry", "KissIcpParams"]

NO_DESKEW = np.array([])


class KissIcpParams(IcpParams):
    """Parameters of KISS-ICP that depend on the sensor."""

    stride: int = Field(
        3, gt=0, description="Every n-th pixel of rows and columns becomes a point."
    )
    min_range_m: float = Field(
        0.1, ge=0, description="Depths nearer than this many metres are dropped."
    )
    max_range_m: float = Field(
        5.0, gt=0, description="Depths farther than this many metres are dropped."
    )
    n_threads: int = Field(
        1, ge=0, description="Number of threads; 0 uses all cores, 1 is often faster."
    )


class KissIcpOdometry:
    """Frame-to-map odometry of depth frames.

    KISS-ICP's own defaults are for a LiDAR: metres between frames, voxels of a metre. The
    defaults here are for a depth camera indoors.
    """

    Params = KissIcpParams

    def __init__(self, params: KissIcpParams | None = None) -> None:
        self.params = params or KissIcpParams()
        self.reset()

    def reset(self) -> None:
        """Forget the map: the next frame is a first one."""
        p = self.params
        config = KISSConfig()
        config.data.deskew = False
        config.data.min_range = p.min_range_m
        config.data.max_range = p.max_range_m
        config.mapping.voxel_size = p.voxel_size_m
        config.mapping.max_points_per_voxel = p.max_points_per_voxel
        config.adaptive_threshold.initial_threshold = p.initial_threshold_m
        config.adaptive_threshold.min_motion_th = p.min_motion_m
        config.registration.max_num_iterations = p.max_iterations
        config.registration.convergence_criterion = p.convergence
        config.registration.max_num_threads = p.n_threads
        self._kiss_icp = KissICP(config)

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera`` (4, 4); a frame that shows too little repeats the last pose."""
        stride = self.params.stride
        points = back_project(frame.depth_m(stride), frame.intrinsics, stride)
        if len(points) < self.params.min_points:
            self._kiss_icp.last_delta = np.eye(4)
            return np.array(self._kiss_icp.last_pose)
        self._kiss_icp.register_frame(points, NO_DESKEW)
        # Thousands of products of rotations drift off SO(3) and GTSAM does not forgive it.
        T = self._kiss_icp.last_pose
        self._kiss_icp.last_pose = se3.nearest_pose(T)
        return np.array(self._kiss_icp.last_pose)
