#!/usr/bin/env python3
"""Close loops inside KISS-ICP's own pipeline, on point clouds without a depth image.

    scripts/examples/inside_kiss_icp.py                           # a synthetic LiDAR in a flat
    scripts/examples/inside_kiss_icp.py --dataloader ouster --data walk.pcap --max-range 20

KISS-ICP's ``OdometryPipeline`` runs as it is. What it shows each scan to, its visualizer, is
``LoopClosing`` here, which hands the scan on to ``LoopCloser.process_points``.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from kiss_icp.datasets import dataset_factory
from kiss_icp.kiss_icp import KissICP
from kiss_icp.pipeline import OdometryPipeline

from slam_bof import LoopCloser, evaluation
from slam_bof.geometry import se3
from slam_bof.synthetic import Lidar, LidarParams, make_flat, make_tour
from slam_bof.types import EdgeKind, Trajectory

T_LIDAR_CAMERA = se3.pose([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], np.zeros(3))
"""LiDARs have x forward, y left, z up; cameras x right, y down, z forward."""
SCANS_PER_S = 10.0
"""Of no matter, but that times grow."""


class LoopClosing:
    """Stands where KISS-ICP's visualizer would."""

    def __init__(self, closer: LoopCloser) -> None:
        self.closer = closer
        self.n_scans = 0

    def update(
        self, points_lidar: Any, keypoints: Any, local_map: Any, T_odom_lidar: Any, infos: Any
    ) -> None:
        points_camera = se3.transform(se3.inverse(T_LIDAR_CAMERA), np.asarray(points_lidar))
        T_odom_camera = se3.inverse(T_LIDAR_CAMERA) @ T_odom_lidar @ T_LIDAR_CAMERA
        self.closer.process_points(
            self.n_scans / SCANS_PER_S, points_camera, se3.nearest_pose(T_odom_camera)
        )
        self.n_scans += 1


class SyntheticFlat:
    """Scans of a walk through a flat, as KISS-ICP takes data sets: points and times of each."""

    data_dir = sequence_id = "flat"

    def __init__(self, every: int) -> None:
        flat = make_flat()
        self._lidar = Lidar(flat.mesh, LidarParams(n_rings=32, n_columns=512, half_angle_deg=30.0))
        self._T_world_camera = make_tour(flat)[::every]
        T_first_camera = se3.inverse(self._T_world_camera[0]) @ self._T_world_camera
        self.gt_poses = T_LIDAR_CAMERA @ T_first_camera @ se3.inverse(T_LIDAR_CAMERA)

    def __len__(self) -> int:
        return len(self._T_world_camera)

    def __getitem__(self, index: int) -> tuple[Any, Any]:
        points_camera = self._lidar.scan(self._T_world_camera[index], seed=index)
        return se3.transform(T_LIDAR_CAMERA, points_camera), np.array([])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dataloader", help="one of KISS-ICP's; the synthetic flat by default")
    parser.add_argument("--data", type=Path, help="what it loads")
    parser.add_argument("--max-range", type=float, default=20.0, help="metres")
    parser.add_argument("--voxel-size", type=float, default=0.2, help="metres")
    parser.add_argument("--n-scans", type=int, default=-1, help="all by default")
    parser.add_argument("--every", type=int, default=9, help="of the synthetic walk's 30 a second")
    arguments = parser.parse_args()
    if arguments.dataloader:
        dataset = dataset_factory(arguments.dataloader, arguments.data)
    else:
        dataset = SyntheticFlat(arguments.every)
    pipeline = OdometryPipeline(dataset, n_scans=arguments.n_scans)
    pipeline.config.data.max_range = arguments.max_range
    pipeline.config.data.min_range = 0.1
    pipeline.config.mapping.voxel_size = arguments.voxel_size
    pipeline.config.registration.max_num_threads = 1
    pipeline.odometry = KissICP(pipeline.config)

    closer = LoopCloser.from_preset("indoor")
    pipeline.visualizer = LoopClosing(closer)
    pipeline._run_pipeline()  # run() would write KISS-ICP's own results as well
    trajectory = closer.finish()  # T_map_camera of each scan

    n_loops = sum(loop.kind == EdgeKind.LOOP for loop in closer.map.loops)
    print(f"{len(trajectory)} scans, {len(closer.map.keyframes)} keyframes, {n_loops} loops")
    if pipeline.has_gt:
        stamps_s = trajectory.stamps_s
        truth = Trajectory(stamps_s, pipeline.gt_poses @ T_LIDAR_CAMERA)
        before = evaluation.ate(Trajectory(stamps_s, pipeline.poses @ T_LIDAR_CAMERA), truth)
        after = evaluation.ate(trajectory, truth)
        if before and after:
            print(f"ATE {before.rmse_m:.3f} m by KISS-ICP, {after.rmse_m:.3f} m after loops")


if __name__ == "__main__":
    main()
