"""Writers of the layouts that slam_bof reads, for ``write_formats`` and ``fuzz``."""

from __future__ import annotations

import json
import struct
import zlib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from slam_bof.datasets import CameraFrame, FolderWriter
from slam_bof.geometry import se3, write_tum
from slam_bof.types import Array, DepthFrame, Trajectory

__all__ = [
    "ODOMETRY",
    "stored",
    "write_bag",
    "write_folder",
    "write_png",
    "write_replica",
    "write_scannet",
    "write_tum_layout",
]

TOPIC, INFO, ODOMETRY = "/camera/depth/image_raw", "/camera/depth/camera_info", "/odom"


def stored(frame: DepthFrame, units_per_m: float) -> Any:
    """Return depth as (H, W) uint16 in units of a layout."""
    return np.round(frame.depth_m().astype(np.float64) * units_per_m).clip(0, 65534).astype("<u2")


def write_png(path: Path, image: Any) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), image)


def write_tum_layout(folder: Path, frames: list[DepthFrame], truth: Trajectory) -> None:
    names = [f"depth/{frame.stamp_s:.6f}.png" for frame in frames]
    for name, frame in zip(names, frames, strict=True):
        write_png(folder / name, stored(frame, 5000))
    lines = [f"{f.stamp_s:.6f} {name}\n" for name, f in zip(names, frames, strict=True)]
    (folder / "depth.txt").write_text("".join(lines))
    write_tum(folder / "groundtruth.txt", truth)


def write_replica(folder: Path, frames: list[DepthFrame], truth: Trajectory) -> None:
    for number, frame in enumerate(frames):
        write_png(folder / "results" / f"depth{number:06d}.png", stored(frame, 6553.5))
    np.savetxt(folder / "traj.txt", truth.poses.reshape(-1, 16))
    camera = frames[0].intrinsics
    values = {"w": camera.width, "h": camera.height, "fx": camera.fx, "fy": camera.fy}
    values |= {"cx": camera.cx, "cy": camera.cy, "scale": 6553.5}
    (folder / "cam_params.json").write_text(json.dumps({"camera": values}))


def write_folder(folder: Path, frames: list[DepthFrame], truth: Trajectory) -> None:
    about = SimpleNamespace(intrinsics=frames[0].intrinsics, units_per_m=1000.0, fps=30.0)
    writer = FolderWriter(folder, about)
    for number, frame in enumerate(frames):
        writer.write(CameraFrame(frame.stamp_s, number, stored(frame, 1000)))
    write_tum(folder / "groundtruth.txt", truth)


def write_scannet(folder: Path, frames: list[DepthFrame], truth: Trajectory) -> None:
    camera = frames[0].intrinsics
    K = np.eye(4, dtype="<f4")
    K[0, 0], K[1, 1], K[0, 2], K[1, 2] = camera.fx, camera.fy, camera.cx, camera.cy
    eye = np.eye(4, dtype="<f4").tobytes()
    parts = [struct.pack("<IQ", 4, 4), b"test", K.tobytes(), eye, K.tobytes(), eye]
    parts.append(struct.pack("<2i4I", 2, 1, 0, 0, camera.width, camera.height))
    parts.append(struct.pack("<fQ", 1000.0, len(frames)))
    for frame, T in zip(frames, truth.poses, strict=True):
        depth = zlib.compress(stored(frame, 1000).tobytes())
        parts.append(T.astype("<f4").tobytes())
        parts.append(struct.pack("<4Q", 0, round(frame.stamp_s * 1e6), 0, len(depth)) + depth)
    folder.mkdir(parents=True)
    (folder / "scene.sens").write_bytes(b"".join(parts))


def write_bag(
    folder: Path, frames: list[DepthFrame], truth: Trajectory, *, storage: str, encoding: str
) -> None:
    is1 = storage == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if is1 else Stores.ROS2_HUMBLE)
    serialise = store.serialize_ros1 if is1 else store.serialize_cdr
    if is1:
        folder.mkdir(parents=True)
        target: Any = Writer1(folder / "recording.bag")
    else:
        target = Writer2(folder, version=9, storage_plugin=StoragePlugin[storage.upper()])

    def make(name: str, **fields: Any) -> Any:
        return store.types[name](**fields)

    with target as writer:
        types = {
            TOPIC: "sensor_msgs/msg/Image",
            INFO: "sensor_msgs/msg/CameraInfo",
            ODOMETRY: "nav_msgs/msg/Odometry",
        }
        topics = {t: writer.add_connection(t, kind, typestore=store) for t, kind in types.items()}

        def send(topic: str, time_ns: int, **fields: Any) -> None:
            sec, nanosec = divmod(time_ns, 10**9)
            stamp = make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
            more = {"seq": 0} if is1 else {}
            header = make("std_msgs/msg/Header", stamp=stamp, frame_id="camera", **more)
            message = make(types[topic], header=header, **fields)
            writer.write(topics[topic], time_ns, serialise(message, types[topic]))

        for number, (frame, T) in enumerate(zip(frames, truth.poses, strict=True)):
            time_ns = round(frame.stamp_s * 1e9) + 10**9
            if number == 0:
                send(INFO, time_ns, **camera_fields(frame, make, is1))
            depth = stored(frame, 1000) if encoding == "16UC1" else frame.depth_m()
            size = {"height": depth.shape[0], "width": depth.shape[1], "step": depth.strides[0]}
            data = depth.view(np.uint8).ravel()
            send(TOPIC, time_ns, **size, encoding=encoding, is_bigendian=0, data=data)
            send(ODOMETRY, time_ns, **odometry_fields(T, make))


def camera_fields(frame: DepthFrame, make: Any, is1: bool) -> dict[str, Any]:
    camera = frame.intrinsics
    K = np.array([camera.fx, 0, camera.cx, 0, camera.fy, camera.cy, 0, 0, 1])
    P = np.insert(K, [3, 6, 9], 0.0)
    matrices = {"D": np.zeros(5), "K": K, "R": np.eye(3).ravel(), "P": P}
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
               do_rectify=False)  # fmt: skip
    return {
        "width": camera.width, "height": camera.height, "distortion_model": "plumb_bob",
        "binning_x": 0, "binning_y": 0, "roi": roi,
        **{name if is1 else name.lower(): value for name, value in matrices.items()},
    }  # fmt: skip


def odometry_fields(T: Array, make: Any) -> dict[str, Any]:
    q = dict(zip("xyzw", se3.to_quaternion(T).tolist(), strict=True))
    t = dict(zip("xyz", T[:3, 3].tolist(), strict=True))
    pose = make(
        "geometry_msgs/msg/Pose",
        position=make("geometry_msgs/msg/Point", **t),
        orientation=make("geometry_msgs/msg/Quaternion", **q),
    )
    zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
    none = np.zeros(36)
    return {
        "child_frame_id": "camera",
        "pose": make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=none),
        "twist": make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=none),
    }
