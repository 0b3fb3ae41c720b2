"""A robot for the node: plays bags to it over DDS, and keeps what it publishes."""

from __future__ import annotations

import array
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Odometry, Path as PathMessage
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.serialization import serialize_message
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore
from sensor_msgs.msg import CameraInfo, Image, PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from slam_bof.geometry import se3
from slam_bof.types import DepthFrame, Intrinsics, Pose
from slam_bof_ros.outputs import time_message

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
PERIOD_S = 0.2
PATIENCE_S = 180.0
TOPICS: dict[str, tuple[type, str, Any]] = {
    "pose": (PoseWithCovarianceStamped, "/slam_bof/pose", 100),
    "map_to_odom": (TransformStamped, "/slam_bof/map_to_odom", 10),
    "path": (PathMessage, "/slam_bof/path", 1),
    "graph": (MarkerArray, "/slam_bof/graph", LATCHED),
    "map": (OccupancyGrid, "/slam_bof/map", LATCHED),
    "cloud": (PointCloud2, "/slam_bof/cloud", 10),
    "scene": (String, "/slam_bof/scene", 10),
    "diagnostics": (DiagnosticArray, "/diagnostics", 10),
}
CAMERA_FRAME = "camera_depth_optical_frame"
MESSAGES = {
    "/depth/camera_info": (CameraInfo, "sensor_msgs/msg/CameraInfo"),
    "/odom": (Odometry, "nav_msgs/msg/Odometry"),
    "/depth/image_rect_raw": (Image, "sensor_msgs/msg/Image"),
}


def write_bag(bag: Path, frames: Sequence[tuple[DepthFrame, Pose]]) -> Path:
    """Write depth images, their camera, and an odometry that names the camera as its child."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with Writer(bag, version=9) as writer:
        topics = {
            topic: writer.add_connection(topic, name, typestore=store)
            for topic, (_, name) in MESSAGES.items()
        }
        for frame, T_odom_camera in frames:
            made = camera_info(frame.intrinsics), odometry(T_odom_camera), image(frame)
            for connection, message in zip(topics.values(), made, strict=True):
                message.header.stamp = time_message(frame.stamp_s)
                writer.write(connection, round(frame.stamp_s * 1e9), serialize_message(message))
    return bag


def camera_info(camera: Intrinsics) -> CameraInfo:
    info = CameraInfo(width=camera.width, height=camera.height)
    info.header.frame_id = CAMERA_FRAME
    info.k = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    info.p = [camera.fx, 0.0, camera.cx, 0.0, 0.0, camera.fy, camera.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return info


def image(frame: DepthFrame) -> Image:
    height, width = frame.depth.shape
    message = Image(height=height, width=width, encoding="16UC1", step=2 * width)
    message.header.frame_id = CAMERA_FRAME
    message.data = array.array("B", frame.depth.tobytes())
    return message


def odometry(T_odom_camera: Pose) -> Odometry:
    message = Odometry(child_frame_id=CAMERA_FRAME)
    message.header.frame_id = "odom"
    t, q = message.pose.pose.position, message.pose.pose.orientation
    t.x, t.y, t.z = T_odom_camera[:3, 3].tolist()
    q.x, q.y, q.z, q.w = se3.to_quaternion(T_odom_camera).tolist()
    return message


class Robot:
    """Starts the node and plays frames to it; keeps what the node says."""

    def __init__(self, environment: dict[str, str], folder: Path) -> None:
        self.heard: defaultdict[str, list[Any]] = defaultdict(list)
        self.map_file = folder / "map.db"
        self._environment, self._folder = environment, folder
        self._processes: list[subprocess.Popen[bytes]] = []
        rclpy.init()
        self._listener = Node("listener")
        for name, (kind, topic, qos) in TOPICS.items():
            self._listener.create_subscription(kind, topic, self.heard[name].append, qos)

    def start(self, **parameters: object) -> subprocess.Popen[bytes]:
        """Start the node; on a machine that is busy no message is lost."""
        values = {"map_file": self.map_file, "graph_period_s": 0.5, "map_period_s": 2.0}
        values |= parameters
        for topic in MESSAGES:
            values[f"qos_overrides.{topic}.subscription.reliability"] = "reliable"
            values[f"qos_overrides.{topic}.subscription.depth"] = 1000
        options = [text for name, value in values.items() for text in ("-p", f"{name}:={value}")]
        return self._run("-m", "slam_bof_ros.node", "--ros-args", *options)

    def play(self, frames: Sequence[tuple[DepthFrame, Pose]], name: str = "walk") -> Path:
        """Play frames with their odometry; return the bag that has them.

        It begins when all that the node publishes is heard.
        """
        topics = [topic for _, topic, _ in TOPICS.values()]
        self.wait_until(lambda: all(map(self._listener.count_publishers, topics)))
        bag = write_bag(self._folder / name, frames)
        player = self._run(str(Path(__file__).with_name("player.py")), str(bag), str(PERIOD_S))
        self.wait_until(lambda: player.poll() is not None)
        assert player.returncode == 0
        return bag

    def wait_until(self, is_so: Callable[[], bool]) -> None:
        deadline_s = time.monotonic() + PATIENCE_S
        while not is_so():
            assert time.monotonic() < deadline_s, {k: len(v) for k, v in self.heard.items()}
            rclpy.spin_once(self._listener, timeout_sec=0.05)

    def call(self, service: str) -> str:
        client = self._listener.create_client(Trigger, f"/slam_bof/{service}")
        self.wait_until(client.service_is_ready)
        answer = client.call_async(Trigger.Request())
        self.wait_until(answer.done)
        assert answer.result().success, answer.result().message
        return str(answer.result().message)

    def markers(self) -> dict[str, Any]:
        """The markers of the newest graph, by namespace."""
        return {marker.ns: marker for marker in self.heard["graph"][-1].markers}

    def n_keyframes(self) -> int:
        """Number of keyframes in the newest graph and path, which come one after the other."""
        heard = self.heard["path"] and self.heard["graph"]
        return len(self.markers()["keyframes"].points) if heard else 0

    def n_frames(self) -> int:
        """Frames that the node has processed, by its newest diagnostics."""
        if not self.heard["diagnostics"]:
            return 0
        values = self.heard["diagnostics"][-1].status[0].values
        healths = ("frames tracked", "frames degenerate", "frames lost")
        return sum(int(v.value) for v in values if v.key in healths)

    def close(self) -> None:
        for process in self._processes:
            if process.poll() is None:
                process.kill()
            process.wait()
        self._listener.destroy_node()
        rclpy.shutdown()

    def _run(self, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, *arguments]
        self._processes.append(subprocess.Popen(command, env=self._environment))
        return self._processes[-1]
