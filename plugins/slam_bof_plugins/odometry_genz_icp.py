"""GenZ-ICP (Lee et al., RA-L 2025): point-to-plane and point-to-point, weighed by the scene.

Composed of its parts: the pipeline that it comes with keeps the size of its voxels in a static
variable, so that a second one in the same process would give other poses than the first.
"""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof.core import one_cpu, silenced
from slam_bof.geometry import PointParams, points_camera, se3
from slam_bof.types import Array, DepthFrame, Pose
from slam_bof_plugins.odometry_icp import IcpParams

with one_cpu(), silenced():
    from genz_icp.mapping import VoxelHashMap
    from genz_icp.pybind.genz_icp_pybind import _AdaptiveThreshold as AdaptiveThreshold
    from genz_icp.registration import Registration
    from genz_icp.voxelization import voxel_down_sample

    # It takes as many threads as there are CPUs when it first aligns, and cannot be told
    # otherwise: here there is one, and it aligns some points with themselves.
    _points = np.random.default_rng(0).uniform(0.0, 1.0, (500, 3))
    _map = VoxelHashMap(0.1, 10.0, 10.0, 0.2, 1)
    _map.add_points(_points)
    Registration(5, 1e-4).align_points_to_map(_points, _map, np.eye(4), 0.3, 0.1)
    del _map, _points

__all__ = ["GenzIcpOdometry", "GenzIcpParams"]


class GenzIcpParams(IcpParams):
    """Parameters of GenZ-ICP that depend on the sensor."""

    points: PointParams = PointParams(stride=3, max_range_m=5.0)
    leaf_size_m: float = Field(
        0.09,
        gt=0,
        description="Side in metres of the voxels that a frame is downsampled to before it is "
        "aligned.",
    )
    planarity_threshold: float = Field(
        0.2, gt=0, description="A surface is a plane where its planarity measure is below this."
    )
    map_radius_m: float = Field(
        8.0, gt=0, description="Points of the map farther than this many metres are removed."
    )


class GenzIcpOdometry:
    """Frame-to-map odometry of depth frames, on one thread."""

    Params = GenzIcpParams

    def __init__(self, params: GenzIcpParams | None = None) -> None:
        self.params = p = params or GenzIcpParams()
        self._registration = Registration(p.max_iterations, p.convergence)
        self.reset()

    def reset(self) -> None:
        """Forget the map: the next frame is a first one."""
        p = self.params
        self._map = VoxelHashMap(
            p.voxel_size_m,
            p.points.max_range_m,
            p.map_radius_m,
            p.planarity_threshold,
            p.max_points_per_voxel,
        )
        self._threshold = AdaptiveThreshold(
            initial_threshold=p.initial_threshold_m,
            min_motion_th=p.min_motion_m,
            max_range=p.points.max_range_m,
        )
        self._T_odom_camera = self._step = np.eye(4)

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera`` (4, 4); a frame that shows too little repeats the last pose."""
        points = points_camera(frame, self.params.points)
        if len(points) < self.params.min_points:
            self._step = np.eye(4)
            return self._T_odom_camera.copy()
        dense = voxel_down_sample(points, 0.5 * self.params.voxel_size_m)
        if not self._map._internal_map._empty():
            self._track(voxel_down_sample(dense, self.params.leaf_size_m))
        self._map.update(dense, self._T_odom_camera)
        return self._T_odom_camera.copy()

    def _track(self, points: Array) -> None:
        """Align a frame, starting from its pose at constant velocity, as KISS-ICP does."""
        sigma = self._threshold._compute_threshold()
        T_guess = self._T_odom_camera @ self._step
        with silenced():  # it draws a figure of its weights for each frame
            found = self._registration.align_points_to_map(
                points, self._map, T_guess, 3.0 * sigma, sigma
            )
        T = se3.nearest_pose(found)
        self._threshold._update_model_deviation(se3.inverse(T_guess) @ T)
        self._step = se3.inverse(self._T_odom_camera) @ T
        self._T_odom_camera = T
