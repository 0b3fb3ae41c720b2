"""Geometric verification with Open3D: FPFH + RANSAC (Rusu 2009), then point-to-plane ICP."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import Field

from slam_bof.core import import_open3d
from slam_bof.geometry import (
    RegistrationQualityParams,
    SurfacePairs,
    assess_registration,
    reject,
    se3,
)
from slam_bof.types import Array, DepthFrame, Pose, Verification

o3d = import_open3d()
registration = o3d.pipelines.registration

__all__ = ["Open3dParams", "Open3dVerifier", "PreparedCloud"]


@dataclass(slots=True, eq=False)
class PreparedCloud:
    """The downsampled cloud of a keyframe with normals, and FPFH features after a global search."""

    cloud: Any
    features: Any = None


class Open3dParams(RegistrationQualityParams):
    """Parameters for indoor depth cameras, with a noise of some centimetres."""

    voxel_size_m: float = Field(
        0.06,
        gt=0,
        description="Edge length of the voxels that clouds are reduced to, in m.",
    )
    normal_radius_m: float = Field(
        0.2,
        gt=0,
        description="Radius in which normals are estimated, in m.",
    )
    max_distance_m: float = Field(
        0.15,
        gt=0,
        description="Largest distance of ICP correspondences, in m.",
    )
    max_iterations: int = Field(20, gt=0, description="Largest number of ICP iterations.")
    feature_radius_m: float = Field(0.4, gt=0, description="Radius of FPFH features, in m.")
    ransac_iterations: int = Field(20000, gt=0, description="Largest number of RANSAC iterations.")
    inlier_distance_m: float = Field(
        0.06,
        gt=0,
        description="Largest distance at which a point counts as overlapping, in m.",
    )


class Open3dVerifier:
    """Registers the clouds of two keyframes, and accepts the result if their surfaces agree."""

    Params = Open3dParams

    def __init__(self, params: Open3dParams | None = None) -> None:
        self.params = params or Open3dParams()

    def prepare(self, frame: DepthFrame, points_camera: Array) -> PreparedCloud:
        """Downsample the points (N, 3) by voxels and estimate normals that face the camera."""
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
        matches: Sequence[PreparedCloud],
        *,
        T_match_query: Array | None = None,
        seed: int = 0,
    ) -> list[Verification]:
        """Register ``query`` with each match from its guess, or by RANSAC without one."""
        if T_match_query is None:
            return [self._verify(query, match, None, seed) for match in matches]
        pairs = zip(matches, T_match_query, strict=True)
        return [self._verify(query, match, guess, seed) for match, guess in pairs]

    def _verify(
        self, query: PreparedCloud, match: PreparedCloud, guess: Pose | None, seed: int
    ) -> Verification:
        p = self.params
        if len(query.cloud.points) < 3 or len(match.cloud.points) < 3:
            return reject("too few points", np.eye(4))
        guessed = guess is not None
        T = self._search(query, match, seed) if guess is None else guess
        for max_distance_m in (p.max_distance_m, p.inlier_distance_m):
            result = registration.registration_icp(
                query.cloud,
                match.cloud,
                max_distance_m,
                T,
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(1e-4, 1e-4, p.max_iterations),
            )
            T = np.array(result.transformation)
        T_match_query = se3.nearest_pose(T)
        pairs = np.asarray(result.correspondence_set)
        if len(pairs) == 0:
            return reject("no correspondences", np.eye(4))
        points_query = np.asarray(query.cloud.points)
        points = points_query[pairs[:, 0]]
        surface, normals = (
            np.asarray(of_match)[pairs[:, 1]]
            for of_match in (match.cloud.points, match.cloud.normals)
        )
        offset = se3.transform(T_match_query, points) - surface
        normals_query = normals @ T_match_query[:3, :3]
        return assess_registration(
            p,
            T_match_query,
            SurfacePairs(
                points_query=points,
                normals_query=normals_query,
                facing_query=normals_query,
                residuals_m=np.einsum("ij,ij->i", offset, normals),
            ),
            overlap=len(pairs) / len(points_query),
            guessed=guessed,
        )

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
