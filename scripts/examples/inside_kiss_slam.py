#!/usr/bin/env python3
"""Recognise places in KISS-SLAM (PyPI: kiss-slam) by slam_bof, in place of its own closer.

    pip install kiss-slam
    scripts/examples/inside_kiss_slam.py                # a synthetic LiDAR in a flat
    scripts/examples/inside_kiss_slam.py --closer own   # the same by KISS-SLAM's MapClosures

KISS-SLAM asks its closer of each finished local map whether it shows a place of an older one, and
from where: ``DepthCloser`` looks at the map's points through a virtual camera and answers by
``PlaceRecogniser`` and a verifier. Odometry, local maps and pose graph stay KISS-SLAM's.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.util
import io
import sys
from typing import Any

import numpy as np
from inside_kiss_icp import T_LIDAR_CAMERA, SyntheticFlat

from slam_bof import PlaceRecogniser, evaluation
from slam_bof.core import import_open3d, registry
from slam_bof.geometry import CloudCamera, PointParams, points_camera, se3
from slam_bof.types import Array, Pose, Trajectory

N_CLOSE = 2
"""Local maps before this one that are no loop with it."""
N_TRIED = 3
"""Places that look alike and are verified, the best first."""

MIN_OVERLAP = 0.6
SLACK_M, SLACK_RAD, DRIFT = 0.3, 0.2, 0.05
"""By how much a loop may move the map, and more for each metre of the way."""


class DepthCloser:
    """Has what KISS-SLAM calls of its ``LoopCloser``."""

    def __init__(self) -> None:
        self._camera = CloudCamera()
        self._recogniser = PlaceRecogniser()
        self._verifier = registry.build("verifiers", "projective")
        self._prepared: list[Any] = []
        self._T_lidar_view: list[Pose] = []

    def compute(
        self, query_id: int, points_lidar: Array, local_maps: Any
    ) -> tuple[bool, int, int, Pose]:
        """Return whether there is a loop, the older map, this one, and ``T_query_older``."""
        T_odom_lidar = local_maps[query_id].keypose
        T_odom_camera = se3.inverse(T_LIDAR_CAMERA) @ T_odom_lidar @ T_LIDAR_CAMERA
        T_odom_camera = se3.nearest_pose(T_odom_camera)
        cloud = se3.transform(se3.inverse(T_LIDAR_CAMERA), points_lidar)
        frame, T_camera_view = self._camera.observe(float(query_id), cloud, T_odom_camera)
        view_id = self._recogniser.add(frame, T_odom_camera @ T_camera_view)
        self._prepared.append(self._verifier.prepare(frame, points_camera(frame, PointParams())))
        self._T_lidar_view.append(T_LIDAR_CAMERA @ T_camera_view)
        for match in self._recogniser.recognise(view_id, max(view_id - N_CLOSE, 0))[:N_TRIED]:
            (verified,) = self._verifier.verify(
                self._prepared[-1],
                [self._prepared[match.view_id]],
                T_match_query=match.T_match_query[None],
            )
            T_view_older = se3.inverse(self._T_lidar_view[match.view_id])
            T_query_older = (
                self._T_lidar_view[-1] @ se3.inverse(verified.T_match_query) @ T_view_older
            )
            is_possible = self._drift_explains(query_id, match.view_id, T_query_older, local_maps)
            if verified.accepted and verified.overlap > MIN_OVERLAP and is_possible:
                return True, match.view_id, query_id, T_query_older
        return False, -1, query_id, np.eye(4)

    @staticmethod
    def _drift_explains(query_id: int, older_id: int, T_query_older: Pose, local_maps: Any) -> bool:
        """Return whether the loop moves the map no more than odometry can have drifted.

        KISS-SLAM's graph has no robust kernel: one wrong loop bends all of it.
        """
        T = np.array([local_maps[k].keypose for k in range(older_id, query_id + 1)])
        way_m = np.linalg.norm(np.diff(T[:, :3, 3], axis=0), axis=1).sum()
        moved = se3.inverse(se3.inverse(T[-1]) @ T[0]) @ T_query_older
        return bool(
            np.linalg.norm(moved[:3, 3]) < SLACK_M + DRIFT * way_m
            and se3.rotation_angle(moved) < SLACK_RAD
        )


def run(closer: str, every: int, n_scans: int) -> tuple[Trajectory, Trajectory, int]:
    """Return the poses, the truth, and how many loops were closed."""
    import_open3d()  # with libusb, which Open3D needs and minimal systems lack
    from kiss_slam.config import KissSLAMConfig
    from kiss_slam.slam import KissSLAM

    config = KissSLAMConfig()
    config.odometry.preprocessing.max_range = 20.0
    config.odometry.preprocessing.min_range = 0.1
    config.odometry.mapping.voxel_size = 0.2
    config.odometry.registration.max_num_threads = 1
    config.local_mapper.voxel_size = 0.05
    config.local_mapper.splitting_distance = 0.5  # metres: of a flat's rooms
    config.loop_closer.detector.density_map_resolution = 0.05
    slam = KissSLAM(config)
    if closer == "slam_bof":
        slam.closer = DepthCloser()
    dataset = SyntheticFlat(every)
    n_scans = min(n_scans, len(dataset))
    for index in range(n_scans):
        slam.process_scan(*dataset[index])
    slam.generate_new_node()
    slam.local_map_graph.erase_last_local_map()
    poses, _ = slam.fine_grained_optimization()
    stamps_s = np.arange(n_scans, dtype=np.float64)
    found = Trajectory(stamps_s, np.array(poses))
    return found, Trajectory(stamps_s, dataset.gt_poses[:n_scans]), len(slam.closures)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--closer", choices=("slam_bof", "own"), default="slam_bof")
    parser.add_argument("--every", type=int, default=9, help="of the synthetic walk's 30 a second")
    parser.add_argument("--n-scans", type=int, default=10**6, help="all by default")
    arguments = parser.parse_args()
    if importlib.util.find_spec("kiss_slam") is None:
        print("kiss_slam is not installed; try: pip install kiss-slam", file=sys.stderr)
        return 1
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of each closure
        found, truth, n_loops = run(arguments.closer, arguments.every, arguments.n_scans)
    error = evaluation.ate(found, truth)
    ate = f"{error.rmse_m:.3f} m" if error else "unknown"
    print(f"{len(found)} scans, {n_loops} loops by {arguments.closer}, ATE {ate}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
