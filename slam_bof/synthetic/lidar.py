"""A model of a spinning LiDAR in a mesh."""

from __future__ import annotations

import numpy as np
from pydantic import Field

from slam_bof.synthetic.meshes import Mesh
from slam_bof.synthetic.scene import ray_casting_scene
from slam_bof.types import Array, Params, Pose

__all__ = ["Lidar", "LidarParams"]


class LidarParams(Params):
    """Parameters of the sensor, by default 64 rings over 90 degrees."""

    n_rings: int = Field(64, gt=1, description="Number of rings.")
    n_columns: int = Field(1024, gt=1, description="Number of points of a ring.")
    half_angle_deg: float = Field(
        45.0,
        gt=0,
        lt=90,
        description="Elevation of the highest ring, and depression of the lowest, in degrees.",
    )
    noise_m: float = Field(
        0.01, ge=0, description="Standard deviation of the noise along the ray, in metres."
    )
    max_range_m: float = Field(
        20.0, gt=0, description="Points farther than this many metres are not returned."
    )


class Lidar:
    """Scans a mesh in the world frame. A scan takes no time."""

    def __init__(self, mesh: Mesh, params: LidarParams | None = None) -> None:
        self.params = p = params or LidarParams()
        self._scene, self._tensor = ray_casting_scene(mesh)
        rings = np.radians(np.linspace(-p.half_angle_deg, p.half_angle_deg, p.n_rings))
        turn = 2.0 * np.pi * np.arange(p.n_columns) / p.n_columns
        azimuth, elevation = np.meshgrid(turn, rings)
        rays = np.stack(
            [
                np.sin(azimuth) * np.cos(elevation),
                np.sin(elevation),
                np.cos(azimuth) * np.cos(elevation),
            ],
            axis=-1,
        )
        self._rays_camera = rays.reshape(-1, 3).astype(np.float32)

    def scan(self, T_world_camera: Pose, *, seed: int = 0) -> Array:
        """Return ``points_camera`` (N, 3): x right, y down, z forward. It turns about y."""
        rays = np.empty((len(self._rays_camera), 6), np.float32)
        rays[:, :3] = T_world_camera[:3, 3]
        rays[:, 3:] = self._rays_camera @ T_world_camera[:3, :3].T.astype(np.float32)
        range_m = self._scene.cast_rays(self._tensor(rays))["t_hit"].numpy().astype(np.float64)
        noise = np.random.default_rng(seed).normal(0.0, self.params.noise_m, range_m.shape)
        seen = range_m < self.params.max_range_m
        return np.asarray((self._rays_camera * (range_m + noise)[:, None])[seen], np.float64)
