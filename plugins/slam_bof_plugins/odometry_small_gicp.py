"""small_gicp (Koide, JOSS 2024): each scan is aligned with a map of Gaussians, one a voxel."""

from __future__ import annotations

import numpy as np
import small_gicp
from pydantic import Field

from slam_bof.geometry import PointParams, points_camera, se3
from slam_bof.types import DepthFrame, Params, Pose

__all__ = ["SmallGicpOdometry", "SmallGicpParams"]

N_THREADS = 1
"""On more, sums are of another order each time, and so are the last bits of poses."""
CLEAR_CYCLE = 10
"""Frames from one clearing of the map to the next."""


class SmallGicpParams(Params):
    """Parameters of small_gicp that depend on the sensor."""

    points: PointParams = PointParams(stride=3, max_range_m=5.0)
    leaf_size_m: float = Field(
        0.06, gt=0, description="Side in metres of the voxels that a frame is downsampled to."
    )
    voxel_size_m: float = Field(0.1, gt=0, description="Side of the map's voxels in metres.")
    n_neighbours: int = Field(
        10, gt=4, description="Number of neighbours by which a point's covariance is estimated."
    )
    max_distance_m: float = Field(
        0.15,
        gt=0,
        description="Largest distance in metres between a point and the mean of its voxel.",
    )
    max_iterations: int = Field(20, gt=0, description="Largest number of iterations.")
    convergence: tuple[float, float] = Field(
        (1e-4, 1e-4), description="Iterations stop when a step is below these limits, in rad and m."
    )
    map_frames: int = Field(
        400, gt=0, description="A voxel is removed when it has not been seen for this many frames."
    )
    min_points: int = Field(
        100, gt=0, description="A frame with fewer points repeats the last pose."
    )


class SmallGicpOdometry:
    """Frame-to-map odometry of depth frames by voxelised GICP."""

    Params = SmallGicpParams

    def __init__(self, params: SmallGicpParams | None = None) -> None:
        self.params = params or SmallGicpParams()
        self.reset()

    def reset(self) -> None:
        """Forget the map: the next frame is a first one."""
        self._map = small_gicp.GaussianVoxelMap(self.params.voxel_size_m)
        self._map.set_lru(horizon=self.params.map_frames, clear_cycle=CLEAR_CYCLE)
        self._T_odom_camera = self._step = np.eye(4)

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera`` (4, 4); a frame that shows too little repeats the last pose."""
        p = self.params
        points = points_camera(frame, p.points)
        if len(points) < p.min_points:
            self._step = np.eye(4)
            return self._T_odom_camera.copy()
        cloud, _ = small_gicp.preprocess_points(
            points,
            downsampling_resolution=p.leaf_size_m,
            num_neighbors=p.n_neighbours,
            num_threads=N_THREADS,
        )
        if self._map.size() > 0:
            self._track(cloud)
        self._map.insert(cloud, self._T_odom_camera)
        return self._T_odom_camera.copy()

    def _track(self, cloud: small_gicp.PointCloud) -> None:
        """Align a frame, starting from its pose at constant velocity."""
        p = self.params
        found = small_gicp.align(
            self._map,
            cloud,
            self._T_odom_camera @ self._step,
            max_correspondence_distance=p.max_distance_m,
            num_threads=N_THREADS,
            max_iterations=p.max_iterations,
            rotation_epsilon=p.convergence[0],
            translation_epsilon=p.convergence[1],
        ).T_target_source
        T = se3.nearest_pose(found)
        self._step = se3.inverse(self._T_odom_camera) @ T
        self._T_odom_camera = T
