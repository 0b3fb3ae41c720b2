"""KISS-ICP (Vizzo et al., RA-L 2023) with a preset for indoor depth cameras."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from kiss_icp.config import KISSConfig
from kiss_icp.kiss_icp import KissICP
from pydantic import Field

from slam_bof.geometry import back_project, se3
from slam_bof.types import Array, DepthFrame, Pose
from slam_bof_plugins.adaptive_threshold import AdaptiveThreshold
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
        self._kiss_icp.adaptive_threshold = AdaptiveThreshold(
            p.initial_threshold_m, p.min_motion_m, p.max_range_m
        )

    def state(self) -> dict[str, Array]:
        """Return the local map, its points in the order of its voxels, and the rest."""
        kiss_icp = self._kiss_icp
        points = kiss_icp.local_map.point_cloud().reshape(-1, 3)
        x, y, z = np.floor(points / self.params.voxel_size_m).T
        return {
            # A voxel keeps the order of its points.
            "points_odom": points[np.lexsort((z, y, x))],
            "T_odom_camera": np.array(kiss_icp.last_pose),
            "T_before_last": np.array(kiss_icp.last_delta),
            "threshold": kiss_icp.adaptive_threshold.state(),
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a state of ``state``; ``ValueError`` if it is none."""
        shapes = {name: np.shape(array) for name, array in state.items()}
        n_points = len(state["points_odom"]) if "points_odom" in state else 0
        expected = {
            "points_odom": (n_points, 3),
            "T_odom_camera": (4, 4),
            "T_before_last": (4, 4),
            "threshold": (2,),
        }
        if shapes != expected:
            raise ValueError(f"found arrays of shapes {shapes}, expected {expected}")
        farthest_m = np.abs(state["points_odom"]).max(initial=0.0)
        if not farthest_m < se3.MAX_POSITION_M:
            raise ValueError(f"found a point at {farthest_m:g} m, expected metres")
        for name in ("T_odom_camera", "T_before_last"):
            se3.check_rigid(state[name])
        self.reset()
        kiss_icp = self._kiss_icp
        kiss_icp.adaptive_threshold.restore(state["threshold"])
        kiss_icp.last_pose = np.array(state["T_odom_camera"], np.float64)
        kiss_icp.last_delta = np.array(state["T_before_last"], np.float64)
        kiss_icp.local_map.add_points(np.array(state["points_odom"], np.float64))

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
