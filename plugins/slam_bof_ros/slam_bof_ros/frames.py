"""From messages to frames with poses: depth images, cameras, odometry and its covariance."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple

import numpy as np

from slam_bof.datasets import FramePoseSynchroniser, SynchroniserParams
from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose
from slam_bof_plugins.bag_images import COMPRESSED, IMAGE, decode_depth
from slam_bof_plugins.ros_messages import (
    apply_binning,
    camera_matrix,
    clean_frame,
    pose_matrix,
    seconds,
)
from slam_bof_ros.transforms import TransformTree

__all__ = ["Cloud", "FrameSource", "PosedFrame", "camera_of", "points_of", "step_covariance"]

R_FLU_CAMERA: Array = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the axes of a camera to those of a body: x forward, y left, z up (REP 103)."""
MAX_WAIT_S = 0.2
"""An image whose pose has not come when poses are newer by this is dropped, and counted."""
FLOAT32 = 7
"""Number of this type in sensor_msgs/PointField."""
MAX_GAP_S = 0.5
"""Frames farther apart than this have no covariance of the step between them."""


class Cloud(NamedTuple):
    """Points (N, 3) of a sensor, x right, y down, z forward."""

    stamp_s: float
    points_camera: Array


class PosedFrame(NamedTuple):
    """A depth frame or cloud, its sensor in the odometry frame, and the covariance of the step."""

    frame: DepthFrame | Cloud
    T_odom_camera: Pose
    covariance: Array | None
    frame_id: str


class FrameSource:
    """Puts depth images and odometry together, by their times and the camera's mounting.

    Parameters
    ----------
    tree
        The transforms, which the node keeps up to date.
    odom_frame, base_frame
        The frames of the odometry: those of tf if ``uses_tf``, otherwise those in its messages.
    uses_tf
        Whether poses come from tf and not from nav_msgs/Odometry.
    """

    def __init__(
        self,
        tree: TransformTree,
        *,
        odom_frame: str = "odom",
        base_frame: str = "base_link",
        uses_tf: bool = False,
        uses_covariance: bool = True,
    ) -> None:
        self.tree = tree
        self.problem = ""
        """What keeps images waiting, if anything does."""
        self.odom_frame, self.base_frame = odom_frame, base_frame
        self._uses_tf, self._uses_covariance = uses_tf, uses_covariance
        self._pairs = FramePoseSynchroniser(SynchroniserParams(max_wait_s=MAX_WAIT_S))
        self._intrinsics: Intrinsics | None = None
        self._info: Any = None
        self._camera_frame = ""
        self._early: deque[Any] = deque(maxlen=100)
        """Odometry that waits for the camera or its mounting to be known."""
        self._twists: deque[tuple[float, Array]] = deque(maxlen=200)
        self._last_s = -np.inf

    @property
    def n_dropped(self) -> int:
        """Number of images that no pose was found for."""
        return sum(n for reason, n in self._pairs.counts.items() if reason.startswith("frame"))

    @property
    def n_waiting(self) -> int:
        """Number of images that wait for a pose."""
        return self._pairs.n_waiting

    def add_camera_info(self, message: Any) -> None:
        """Take a sensor_msgs/CameraInfo."""
        self._info = message

    def add_image(self, message: Any, *, is_compressed: bool = False, is_rectified: bool) -> None:
        """Take a depth image: sensor_msgs/Image or, of ``compressedDepth``, CompressedImage.

        Raises
        ------
        DatasetError
            If it is no depth image, or no camera_info of its size has come.
        """
        depth = decode_depth(message, COMPRESSED if is_compressed else IMAGE, "depth image")
        if self._info is None:
            raise DatasetError("depth image: found no camera_info yet, expected one beside it")
        camera = camera_of(self._info, depth.shape, is_rectified=is_rectified)
        frame = DepthFrame(seconds(message.header.stamp), depth, camera)
        self._camera_frame = clean_frame(message.header.frame_id)
        self._add(frame)

    def add_cloud(self, message: Any) -> None:
        """Take a sensor_msgs/PointCloud2 instead of a depth image.

        Its axes are those of a body (REP 103), unless its frame is named an optical one.

        Raises
        ------
        DatasetError
            If it has no coordinates.
        """
        self._camera_frame = clean_frame(message.header.frame_id)
        points = points_of(message)
        if not self._is_optical():
            points = points @ R_FLU_CAMERA
        self._add(Cloud(seconds(message.header.stamp), points))

    def add_odometry(self, message: Any) -> None:
        """Take a nav_msgs/Odometry; one whose pose is none is left out."""
        self.odom_frame = clean_frame(message.header.frame_id) or self.odom_frame
        self.base_frame = clean_frame(message.child_frame_id) or self.base_frame
        self._early.append(message)

    def take(self) -> list[PosedFrame]:
        """Return the frames whose pose is known now, oldest first."""
        while self._early and self._add_pose(self._early[0]):
            self._early.popleft()
        if self._uses_tf:
            self._add_pose_from_tf()
        posed = []
        for frame, T_odom_camera in self._pairs.take():
            covariance = step_covariance(self._twists, self._last_s, frame.stamp_s)
            posed.append(PosedFrame(frame, T_odom_camera, covariance, self._camera_frame))
            self._last_s = frame.stamp_s
            self.problem = ""
        return posed

    def _add(self, frame: DepthFrame | Cloud) -> None:
        if not self._pairs.add_frame(frame):
            self.problem = "too many images wait for odometry: does it come, and on the same clock?"

    def _is_optical(self) -> bool:
        return self._info is not None or "optical" in self._camera_frame

    def _add_pose(self, message: Any) -> bool:
        """Add the pose of an odometry message; False if the mounting is not known yet."""
        stamp_s, T_odom_base = seconds(message.header.stamp), pose_matrix(message.pose.pose)
        T_base_camera = self._mounting(stamp_s)
        if T_base_camera is None:
            return False
        if not np.isfinite(T_odom_base).all():
            return True
        self._pairs.add_pose(stamp_s, T_odom_base @ T_base_camera)
        covariance = np.array(message.twist.covariance, dtype=np.float64).reshape(6, 6)
        if self._uses_covariance and np.diag(covariance).min() >= 0.0 and covariance.any():
            self._twists.append((stamp_s, _carry(covariance, se3.inverse(T_base_camera))))
        return True

    def _add_pose_from_tf(self) -> None:
        for stamp_s in self._pairs.waiting_stamps_s:
            T = self.tree.lookup(self.odom_frame, self._camera_frame, stamp_s)
            if T is not None:
                self._pairs.add_pose(stamp_s, T @ self._T_sensor_camera())

    def _mounting(self, stamp_s: float) -> Pose | None:
        """Return ``T_base_camera``; the identity if the odometry is the camera's own."""
        if not self._camera_frame:
            return None
        T = self.tree.lookup(self.base_frame, self._camera_frame, stamp_s)
        if T is None:
            self.problem = (
                f"found no transform from {self.base_frame} to {self._camera_frame}, "
                "expected one on /tf_static"
            )
        return None if T is None else T @ self._T_sensor_camera()

    def _T_sensor_camera(self) -> Pose:
        """Return the pose of the axes of a camera in the sensor's frame."""
        return np.eye(4) if self._is_optical() else se3.pose(R_FLU_CAMERA, np.zeros(3))


def camera_of(info: Any, shape: tuple[int, ...], *, is_rectified: bool) -> Intrinsics:
    """Return the intrinsics of images (H, W) that a sensor_msgs/CameraInfo describes.

    Raises
    ------
    DatasetError
        If it is of images of another size, or no camera.
    """
    height, width = shape
    K, _ = camera_matrix(info, is_rectified=is_rectified)
    numbers = apply_binning(info, K, width, height)
    if numbers is None:
        raise DatasetError(
            f"camera_info: found a camera of {info.width}x{info.height} pixels, "
            f"expected {width}x{height} as the depth images"
        )
    try:
        return Intrinsics(width, height, *numbers)
    except ValueError as error:
        raise DatasetError(f"camera_info: {error}") from None


def points_of(message: Any) -> Array:
    """Return the points (N, 3) of a sensor_msgs/PointCloud2 that are finite.

    Raises
    ------
    DatasetError
        If it has no fields x, y and z of float32.
    """
    offsets = {field.name: field.offset for field in message.fields if field.datatype == FLOAT32}
    if not {"x", "y", "z"} <= set(offsets):
        listed = ", ".join(field.name for field in message.fields) or "none"
        raise DatasetError(f"cloud: found fields {listed}, expected x, y and z of float32")
    order = ">" if message.is_bigendian else "<"
    kind = np.dtype(
        {
            "names": ["x", "y", "z"],
            "formats": [f"{order}f4"] * 3,
            "offsets": [offsets[name] for name in "xyz"],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(bytes(message.data), np.uint8)
    if message.row_step > message.width * message.point_step:  # padded rows
        rows = rows.reshape(message.height, -1)[:, : message.width * message.point_step].ravel()
    found = np.frombuffer(rows.tobytes(), kind)
    points = np.stack([found["x"], found["y"], found["z"]], axis=1).astype(np.float64)
    return points[np.isfinite(points).all(axis=1)]


def step_covariance(
    twists: deque[tuple[float, Array]], last_s: float, stamp_s: float
) -> Array | None:
    """Return the covariance (6, 6) of the step between two frames, from that of the velocity.

    The error of the velocity is taken as constant over the step. None if no velocity of that time
    is known, or the frames are far apart.
    """
    step_s = stamp_s - last_s
    if step_s > MAX_GAP_S:
        return None
    during = [covariance for t, covariance in twists if last_s < t <= stamp_s + 1e-3]
    return np.mean(during, axis=0) * step_s**2 if during else None


def _carry(covariance: Array, T_camera_base: Pose) -> Array:
    """Return the covariance (6, 6) of a velocity, translation first, along the camera's axes."""
    R, t = T_camera_base[:3, :3], T_camera_base[:3, 3]
    across = np.array([[0, -t[2], t[1]], [t[2], 0, -t[0]], [-t[1], t[0], 0]])
    adjoint = np.block([[R, across @ R], [np.zeros((3, 3)), R]])
    carried = adjoint @ covariance @ adjoint.T
    return np.asarray(0.5 * (carried + carried.T))
