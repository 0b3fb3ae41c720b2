"""Geometric verification with Open3D: FPFH + RANSAC (Rusu 2009), then point-to-plane ICP."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from slam_bof import se3
from slam_bof.native import import_open3d
from slam_bof.types import Array, DepthFrame, Params, Pose, Verification

o3d = import_open3d()
registration = o3d.pipelines.registration

__all__ = ["Open3dParams", "Open3dVerifier", "PreparedCloud"]


@dataclass(slots=True, eq=False)
class PreparedCloud:
    """A keyframe's cloud, thinned, with normals; FPFH features once a global search asks."""

    cloud: Any
    features: Any = None


class Open3dParams(Params):
    """Distances are for indoor depth cameras, whose noise is centimetres at metres."""

    voxel_size_m: float = Field(0.06, gt=0)
    normal_radius_m: float = Field(0.2, gt=0)
    max_distance_m: float = Field(0.15, gt=0, description="of ICP correspondences")
    max_iterations: int = Field(20, gt=0)
    feature_radius_m: float = Field(0.4, gt=0)
    ransac_iterations: int = Field(20000, gt=0)
    min_overlap: float = Field(0.35, ge=0, le=1)
    min_overlap_global: float = Field(0.6, ge=0, le=1, description="where no guess was given")
    inlier_distance_m: float = Field(0.06, gt=0, description="of what counts as overlap")
    max_rmse_m: float = Field(0.05, gt=0)
    min_stiffness: float = Field(
        0.002, ge=0, description="least eigenvalue of the information per point"
    )


class Open3dVerifier:
    """Aligns two keyframes' clouds and judges whether they show the same surfaces."""

    Params = Open3dParams

    def __init__(self, params: Open3dParams | None = None) -> None:
        self.params = params or Open3dParams()

    def prepare(self, frame: DepthFrame, points_camera: Array) -> PreparedCloud:
        """Thin the points (N, 3) to one a voxel and estimate normals towards the camera."""
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_camera))
        cloud = cloud.voxel_down_sample(self.params.voxel_size_m)
        if cloud.is_empty():
            return PreparedCloud(cloud)
        cloud.estimate_normals(
            o3d.geometry.KDTreeSearchParamHybrid(radius=self.params.normal_radius_m, max_nn=30)
        )
        cloud.orient_normals_towards_camera_location()
        return PreparedCloud(cloud)

    def verify(
        self,
        query: PreparedCloud,
        match: PreparedCloud,
        *,
        T_match_query: Pose | None = None,
        seed: int = 0,
    ) -> Verification:
        """Align ``query`` with ``match`` from the guess or, without one, by seeded RANSAC."""
        p = self.params
        if len(query.cloud.points) < 3 or len(match.cloud.points) < 3:
            return _rejected("too few points")
        min_overlap = p.min_overlap if T_match_query is not None else p.min_overlap_global
        guess = self._search(query, match, seed) if T_match_query is None else T_match_query
        for max_distance_m in (p.max_distance_m, p.inlier_distance_m):
            result = registration.registration_icp(
                query.cloud,
                match.cloud,
                max_distance_m,
                guess,
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(1e-4, 1e-4, p.max_iterations),
            )
            guess = result.transformation
        return self._judge(query, match, result, min_overlap)

    def _search(self, query: PreparedCloud, match: PreparedCloud, seed: int) -> Pose:
        """Return a coarse T_match_query by RANSAC over FPFH correspondences."""
        p = self.params
        for prepared in (query, match):
            if prepared.features is None:
                prepared.features = registration.compute_fpfh_feature(
                    prepared.cloud,
                    o3d.geometry.KDTreeSearchParamHybrid(radius=p.feature_radius_m, max_nn=60),
                )
        o3d.utility.random.seed(seed)
        result = registration.registration_ransac_based_on_feature_matching(
            query.cloud,
            match.cloud,
            query.features,
            match.features,
            True,
            p.max_distance_m,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(p.max_distance_m),
            ],
            registration.RANSACConvergenceCriteria(p.ransac_iterations, 0.999),
        )
        return np.asarray(result.transformation)

    def _judge(
        self, query: PreparedCloud, match: PreparedCloud, result: Any, min_overlap: float
    ) -> Verification:
        p = self.params
        T = np.array(result.transformation)
        T_match_query = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
        pairs = np.asarray(result.correspondence_set)
        points_query = np.asarray(query.cloud.points)
        if len(pairs) == 0:
            return _rejected("no correspondences")
        source, target = pairs[:, 0], pairs[:, 1]
        p_query = points_query[source]
        n_query = np.asarray(match.cloud.normals)[target] @ T_match_query[:3, :3]
        offset = se3.transform(T_match_query, p_query) - np.asarray(match.cloud.points)[target]
        residual = np.einsum("ij,ij->i", offset, np.asarray(match.cloud.normals)[target])
        overlap = len(pairs) / len(points_query)
        rmse_m = float(np.sqrt(np.mean(residual**2)))
        jacobian = np.hstack([np.cross(p_query, n_query), n_query])
        information = jacobian.T @ jacobian
        stiffness = float(np.linalg.eigvalsh(information)[0]) / len(pairs)
        if overlap < min_overlap:
            reason = f"overlap {overlap:.2f} below {min_overlap:g}"
        elif rmse_m > p.max_rmse_m:
            reason = f"residual {rmse_m:.3f} m above {p.max_rmse_m:g} m"
        elif stiffness < p.min_stiffness:
            reason = f"degenerate: stiffness {stiffness:.4f} below {p.min_stiffness:g}"
        else:
            return Verification(True, "", T_match_query, overlap, rmse_m, information)
        return Verification(False, reason, T_match_query, overlap, rmse_m, information)


def _rejected(reason: str) -> Verification:
    return Verification(False, reason, np.eye(4), 0.0, float("inf"), np.zeros((6, 6)))
