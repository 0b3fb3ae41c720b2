"""Times, poses and cameras of ROS messages, of a bag or of a running node.

Messages are read by the names of their fields, so that those of ROS 1, ROS 2 and rosbags will do.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = [
    "apply_binning",
    "camera_matrix",
    "clean_frame",
    "pose_matrix",
    "scale_center",
    "seconds",
    "transform_matrix",
]


def clean_frame(frame: str) -> str:
    """Return the name of a frame without the slash that ROS 1 allowed at its start."""
    return frame.removeprefix("/")


def seconds(stamp: Any) -> float:
    """Return a time in seconds, rounded as ``dataset_bag`` rounds those of images."""
    return float((stamp.sec * 10**9 + stamp.nanosec) / 1e9)


def pose_matrix(pose: Any) -> Pose:
    """Return a geometry_msgs/Pose as (4, 4); NaN where it cannot be one."""
    return _matrix(pose.orientation, pose.position)


def transform_matrix(transform: Any) -> Pose:
    """Return a geometry_msgs/Transform as (4, 4); NaN where it cannot be one."""
    return _matrix(transform.rotation, transform.translation)


def camera_matrix(info: Any, *, is_rectified: bool) -> tuple[Array, bool]:
    """Return the matrix (3, 3) of a CameraInfo, and whether images are distorted by the lens.

    Of rectified images it is the left part of the projection.
    """
    # ROS 1 has the matrices in capitals.
    K = np.asarray(info.k if hasattr(info, "k") else info.K).reshape(3, 3)
    P = np.asarray(info.p if hasattr(info, "p") else info.P).reshape(3, 4)
    D = np.asarray(info.d if hasattr(info, "d") else info.D)
    if is_rectified and P[0, 0] > 0.0:
        return P[:, :3], False
    return K, bool(D.any())


def apply_binning(info: Any, K: Array, width: int, height: int) -> tuple[float, ...] | None:
    """Return fx, fy, cx, cy of the images, by the region of interest and then the binning.

    Both refer to the full image that CameraInfo describes. None if the images are then of another
    size.
    """
    fx, fy, cx, cy = (float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    if (info.width, info.height) == (width, height):
        return fx, fy, cx, cy
    roi, bins = info.roi, (max(info.binning_x, 1), max(info.binning_y, 1))
    full = (roi.width or info.width, roi.height or info.height)
    if (full[0] // bins[0], full[1] // bins[1]) != (width, height):
        return None
    cx = scale_center(cx - roi.x_offset, 1 / bins[0])
    cy = scale_center(cy - roi.y_offset, 1 / bins[1])
    return fx / bins[0], fy / bins[1], cx, cy


def scale_center(center: float, share: float) -> float:
    """Return a coordinate, which counts from the centre of the first pixel, in a smaller image."""
    return (center + 0.5) * share - 0.5


def _matrix(q: Any, t: Any) -> Pose:
    quaternion = np.array([q.x, q.y, q.z, q.w])
    is_near = max(abs(t.x), abs(t.y), abs(t.z)) < se3.MAX_POSITION_M
    if not is_near or not 0.5 < np.linalg.norm(quaternion) < 2.0:
        return np.full((4, 4), np.nan)  # all zeros: the writer knew no pose
    return se3.from_quaternion(quaternion, (t.x, t.y, t.z))
