"""Bags in all three formats, by rosbags' own writers, to read back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from datasets import HEIGHT, WIDTH, ramp
from numpy.typing import NDArray

from slam_bof.geometry import se3

pytest.importorskip("rosbags", reason="needs pip install slam-bof[bag]")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(  # which is not among those that come along for ROS 1
    get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage")
)
FORMATS = ["ros1", "sqlite3", "mcap"]
START_NS = 1_700_000_000_000_000_000
TOPIC = "/camera/depth/image_rect_raw"
INFO = "/camera/depth/camera_info"
FRAME = "camera_depth_optical_frame"


class Bag:
    """Writes messages of either ROS by the same few calls."""

    def __init__(self, version: int, writer: Any) -> None:
        self.store = STORES[version]
        self._version = version
        self._writer = writer
        self._connections: dict[str, Any] = {}

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def write(self, topic: str, time_ns: int, message: Any) -> None:
        if topic not in self._connections:
            self._connections[topic] = self._writer.add_connection(
                topic, message.__msgtype__, typestore=self.store
            )
        serialise = self.store.serialize_ros1 if self._version == 1 else self.store.serialize_cdr
        self._writer.write(
            self._connections[topic], time_ns, serialise(message, message.__msgtype__)
        )

    def stamp(self, time_ns: int) -> Any:
        sec, nanosec = divmod(time_ns, 10**9)
        return self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def header(self, time_ns: int, frame: str = FRAME) -> Any:
        more = {"seq": 0} if self._version == 1 else {}
        stamp = self.stamp(time_ns)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=frame, **more)

    def image(
        self, topic: str, time_ns: int, image: NDArray[Any], encoding: str, *, pad: int = 0,
        big: bool = False, stamp_ns: int | None = None, received_ns: int | None = None,
    ) -> None:  # fmt: skip
        data = image.astype(image.dtype.newbyteorder(">" if big else "<"))
        rows = data.view(np.uint8).reshape(image.shape[0], -1)
        rows = np.hstack([rows, np.full((len(rows), pad), 255, np.uint8)])
        message = self.make(
            "sensor_msgs/msg/Image",
            header=self.header(time_ns if stamp_ns is None else stamp_ns),
            height=image.shape[0],
            width=image.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=rows.shape[1],
            data=rows.ravel(),
        )
        self.write(topic, received_ns or time_ns + 5_000_000, message)

    def compressed(self, topic: str, time_ns: int, data: bytes, coding: str) -> None:
        message = self.make(
            "sensor_msgs/msg/CompressedImage",
            header=self.header(time_ns),
            format=coding,
            data=np.frombuffer(data, np.uint8),
        )
        self.write(topic, time_ns, message)

    def camera(self, topic: str, *, size: tuple[int, int] = (WIDTH, HEIGHT), fx: float = 30.0,
               fy: float = 31.0, centre: tuple[float, float] = (16.0, 12.0),
               frame: str = FRAME, binning: int = 0, roi: tuple[int, int, int, int] = (0, 0, 0, 0),
               ) -> None:  # fmt: skip
        cx, cy = centre
        K = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1], float)
        P = np.insert(K, [3, 6, 9], 0.0)
        names = ("D", "K", "R", "P") if self._version == 1 else ("d", "k", "r", "p")
        matrices = dict(zip(names, (np.zeros(5), K, np.eye(3).ravel(), P), strict=True))
        x, y, roi_width, roi_height = roi
        region = self.make(
            "sensor_msgs/msg/RegionOfInterest", x_offset=x, y_offset=y, height=roi_height,
            width=roi_width, do_rectify=False,
        )  # fmt: skip
        message = self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(START_NS, frame), width=size[0],
            height=size[1], distortion_model="plumb_bob", binning_x=binning,
            binning_y=binning, roi=region, **matrices,
        )  # fmt: skip
        self.write(topic, START_NS, message)

    def geometry(self, T: NDArray[np.float64]) -> tuple[Any, Any]:
        """Make the translation and the quaternion of a pose."""
        x, y, z, w = se3.to_quaternion(T).tolist()
        q = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return T[:3, 3].tolist(), q

    def odometry(self, topic: str, time_ns: int, T: NDArray[np.float64], child: str) -> None:
        (x, y, z), q = self.geometry(T)
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        message = self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(time_ns, "odom"),
            child_frame_id=child,
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.make(
                    "geometry_msgs/msg/Pose",
                    position=self.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
                    orientation=q,
                ),
                covariance=np.zeros(36),
            ),
            twist=self.make(
                "geometry_msgs/msg/TwistWithCovariance",
                twist=self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero),
                covariance=np.zeros(36),
            ),
        )
        self.write(topic, time_ns, message)

    def tf(self, topic: str, time_ns: int, parent: str, child: str, T: Any) -> None:
        (x, y, z), q = self.geometry(T)
        item = self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(time_ns, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z),
                rotation=q,
            ),
        )
        self.write(topic, time_ns, self.make("tf2_msgs/msg/TFMessage", transforms=[item]))


@contextmanager
def writing(folder: Path, form: str, packing: str = "") -> Iterator[tuple[Bag, Path]]:
    if form == "ros1":
        path = folder / "toy.bag"
        old = Writer1(path)
        if packing:
            old.set_compression(Writer1.CompressionFormat[packing])
        with old:
            yield Bag(1, old), path
    else:
        path = folder / f"toy_{form}"
        new = Writer2(path, version=9, storage_plugin=StoragePlugin[form.upper()])
        if packing:
            new.set_compression(CompressionMode[packing], CompressionFormat.ZSTD)
        with new:
            yield Bag(2, new), path


def time_ns(number: float) -> int:
    return START_NS + round(number * 33_333_333)


def write(folder: Path, form: str, packing: str = "", *, n: int = 4, **options: Any) -> Path:
    """Write ramps of 16UC1 with their camera, and images of another camera in between."""
    with writing(folder, form, packing) as (bag, path):
        bag.camera(INFO)
        for number in range(n):
            bag.image("/camera/color", time_ns(number) + 7, np.zeros((4, 4), np.uint8), "mono8")
            bag.image(TOPIC, time_ns(number), ramp(number), "16UC1", **options)
    return path


def png(image: NDArray[np.uint16]) -> bytes:
    return bytes(cv2.imencode(".png", image)[1].tobytes())
