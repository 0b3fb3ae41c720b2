"""Open3D's depth odometry: against the frame before, or against the last keyframe.

Point-to-plane with projective association (KinectFusion, Newcombe et al., ISMAR 2011), coarse to
fine. Of what else Open3D has, its hybrid of depth and colour (Park et al., ICCV 2017) needs an
intensity image, and there is depth alone; and the surface that its volumetric model shows
(``t.pipelines.slam.Model``, of 0.20) stands some 0.3 to 1 voxels along each axis of the world from
where it was seen, which adds up from frame to frame.
"""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.core import import_open3d
from slam_bof.geometry import se3
from slam_bof.types import DepthFrame, Intrinsics, Params, Pose

o3d = import_open3d()

__all__ = ["Open3dOdometry", "Open3dOdometryParams"]

METRE = 1.0
"""How many units of depth make a metre."""


class Open3dOdometryParams(Params):
    """The image that each frame is aligned with, and the alignment."""

    method: Literal["frame-to-keyframe", "frame-to-frame"] = Field(
        "frame-to-keyframe",
        description="Whether a frame is aligned with the last keyframe or with the last frame.",
    )
    keyframe_m: float = Field(
        0.1,
        gt=0,
        description="A frame this many metres from the last keyframe becomes the next one.",
    )
    keyframe_rad: float = Field(
        0.15,
        gt=0,
        description="A frame turned by this many radians since the last keyframe becomes the next"
        " one.",
    )
    stride: int = Field(4, gt=0, description="Every n-th pixel of rows and columns is used.")
    min_range_m: float = Field(
        0.1, ge=0, description="Depths nearer than this many metres are dropped."
    )
    max_range_m: float = Field(
        5.0, gt=0, description="Depths farther than this many metres are dropped."
    )
    iterations: tuple[int, ...] = Field(
        (10, 5, 5),
        description="Number of iterations at each level of the image pyramid, from coarse to fine.",
    )
    max_distance_m: float = Field(
        0.07, gt=0, description="Largest distance of corresponding points in metres."
    )
    min_fitness: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Least share of points with a correspondence; below it a frame is not aligned.",
    )
    min_points: int = Field(
        100, gt=0, description="A frame with fewer valid pixels is not aligned."
    )


class Open3dOdometry:
    """Odometry of depth images. A frame that cannot be aligned repeats the last pose."""

    Params = Open3dOdometryParams

    def __init__(self, params: Open3dOdometryParams | None = None) -> None:
        self.params = p = params or Open3dOdometryParams()
        odometry = o3d.t.pipelines.odometry
        self._criteria = [odometry.OdometryConvergenceCriteria(n, 1e-6, 1e-6) for n in p.iterations]
        self._loss = odometry.OdometryLossParams(p.max_distance_m)
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next frame is a first one."""
        self._T_odom_camera = self._T_odom_keyframe = self._step = np.eye(4)
        self._keyframe = self._before = None

    def process(self, frame: DepthFrame) -> Pose:
        """Return ``T_odom_camera`` (4, 4); a frame that shows too little repeats the last pose."""
        image = self._image(frame)
        if image is None:
            self._step = np.eye(4)
        elif self._keyframe is None:
            self._keyframe = image
        else:
            self._track(image, _matrix(frame.intrinsics, self.params.stride))
        self._before = image or self._before
        return self._T_odom_camera.copy()

    def _track(self, image: Any, camera: Any) -> None:
        """Align a frame, starting from its pose at constant velocity; keep its image if due."""
        p = self.params
        T_guess = self._T_odom_camera @ self._step
        T_last = self._T_odom_camera
        T = self._align(image, self._keyframe, camera, self._T_odom_keyframe, T_guess)
        if T is None and self._before is not self._keyframe:
            T = self._align(image, self._before, camera, T_last, T_last)
        is_lost = T is None
        self._T_odom_camera = T_last if T is None else T
        self._step = se3.inverse(T_last) @ self._T_odom_camera
        moved = se3.inverse(self._T_odom_keyframe) @ self._T_odom_camera
        if (
            is_lost
            or p.method == "frame-to-frame"
            or np.linalg.norm(moved[:3, 3]) > p.keyframe_m
            or se3.rotation_angle(moved) > p.keyframe_rad
        ):
            self._keyframe, self._T_odom_keyframe = image, self._T_odom_camera

    def _align(
        self, image: Any, reference: Any, camera: Any, T_odom_reference: Pose, T_guess: Pose
    ) -> Pose | None:
        """Return ``T_odom_camera`` by a reference image, if enough of the image matches."""
        odometry = o3d.t.pipelines.odometry
        try:
            found = odometry.rgbd_odometry_multi_scale(
                image,
                reference,
                camera,
                o3d.core.Tensor(se3.inverse(T_odom_reference) @ T_guess),
                METRE,
                self.params.max_range_m,
                self._criteria,
                odometry.Method.PointToPlane,
                self._loss,
            )
        except RuntimeError:  # no pixel matches, or all lie on one plane: a singular system
            return None
        T = T_odom_reference @ found.transformation.numpy()
        if found.fitness < self.params.min_fitness or not np.isfinite(T).all():
            return None
        return se3.nearest_pose(T)

    def _image(self, frame: DepthFrame) -> Any:
        """Return Open3D's image of the frame, if it shows enough."""
        p = self.params
        depth_m = frame.depth_m(p.stride)
        depth_m[(depth_m < p.min_range_m) | (depth_m > p.max_range_m)] = 0.0
        if np.count_nonzero(depth_m) < p.min_points:
            return None
        # Colour must be there, but is not looked at.
        black = np.zeros((*depth_m.shape, 3), np.float32)
        return o3d.t.geometry.RGBDImage(_tensor_image(black), _tensor_image(depth_m[..., None]))


def _matrix(intrinsics: Intrinsics, stride: int) -> Any:
    """Return the (3, 3) matrix of the camera of every ``stride``-th pixel."""
    c = intrinsics
    return o3d.core.Tensor(
        np.array([[c.fx, 0.0, c.cx], [0.0, c.fy, c.cy], [0.0, 0.0, stride]]) / stride
    )


def _tensor_image(values: NDArray[np.float32]) -> Any:
    return o3d.t.geometry.Image(o3d.core.Tensor(np.ascontiguousarray(values)))
