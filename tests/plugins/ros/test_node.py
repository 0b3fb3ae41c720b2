"""The node over DDS: frames and odometry come from another process, what it says is checked here.

Needs the extra ``ros``, or a ROS 2 installation. The messages of tf (tf2_msgs) are not among the
wheels: where they are missing, ``~/map_to_odom`` stands for them.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="needs ROS 2: pip install -e '.[ros]', or a ROS installation")

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from nav_msgs.msg import OccupancyGrid, Path as PathMessage
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import String
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from slam_bof.geometry import se3
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.config import override
from slam_bof.store import MapStore
from slam_bof.types import DepthFrame, Intrinsics, Pose
from slam_bof_plugins.ros_messages import pose_matrix, seconds, transform_matrix

# Of the wheels' parser of message definitions.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

ROOT = Path(__file__).resolve().parents[3]
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
UPRIGHT = "gravity_odom=[0,1,0]"
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


@pytest.fixture(scope="module")
def environment() -> Iterator[dict[str, str]]:
    """A DDS domain of our own on this machine."""
    ours = {"ROS_DOMAIN_ID": str(os.getpid() % 100 + 1), "ROS_LOCALHOST_ONLY": "1"}
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    paths = [ROOT, ROOT / "plugins", ROOT / "plugins" / "slam_bof_ros"]
    yield {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, paths))}
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


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
        values = {"map_file": self.map_file, "set": json.dumps([UPRIGHT]), "graph_period_s": 0.5,
                  "map_period_s": 2.0, **parameters}  # fmt: skip
        options = [text for name, value in values.items() for text in ("-p", f"{name}:={value}")]
        return self._run("-m", "slam_bof_ros.node", "--ros-args", *options)

    def play(self, frames: list[tuple[DepthFrame, Pose]]) -> None:
        camera = frames[0][0].intrinsics
        file = self._folder / "frames.npz"
        np.savez(
            file,
            camera=[camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy],
            stamps_s=[frame.stamp_s for frame, _ in frames],
            depths=[frame.depth for frame, _ in frames],
            poses=[T for _, T in frames],
        )
        player = self._run(str(Path(__file__).with_name("player.py")), str(file), str(PERIOD_S))
        self.wait_until(lambda: player.poll() is not None)
        assert player.returncode == 0

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


@pytest.fixture
def robot(environment: dict[str, str], tmp_path: Path) -> Iterator[Robot]:
    robot = Robot(environment, tmp_path)
    yield robot
    robot.close()


@pytest.fixture(scope="module")
def frames(walk: list[tuple[DepthFrame, Pose]]) -> list[tuple[DepthFrame, Pose]]:
    """The walk there and back at half the size, with odometry that drifts by 4 mm a frame."""
    small = []
    for k, (frame, T) in enumerate([*walk[:20], *walk[:19:-1]]):
        c = frame.intrinsics
        half = Intrinsics(c.width // 2, c.height // 2, c.fx / 2, c.fy / 2, c.cx / 2, c.cy / 2)
        drift = se3.pose(np.eye(3), [0.004 * k, 0.0, 0.0])
        depth = np.ascontiguousarray(frame.depth[::2, ::2])
        small.append((DepthFrame(100.0 + 0.3 * k, depth, half), drift @ T))
    return small


def loops_in(map_file: Path) -> set[tuple[int, int]]:
    with MapStore.open(map_file) as store:
        return {(c.query_id, c.match_id) for c in store.candidates() if c.decision == "accepted"}


def test_a_node_maps_what_is_played_to_it(
    robot: Robot, frames: list[tuple[DepthFrame, Pose]]
) -> None:
    node = robot.start()
    robot.play(frames)
    robot.wait_until(lambda: robot.n_frames() == len(frames))
    topics = "map", "cloud", "scene", "pose", "map_to_odom"
    robot.wait_until(lambda: all(robot.heard[topic] for topic in topics))
    robot.wait_until(lambda: 4 < robot.n_keyframes() == len(robot.heard["path"][-1].poses))
    pose = robot.heard["pose"][-1]
    assert pose.header.frame_id == "map"
    # It ends where it began.
    off_m = np.linalg.norm(pose_matrix(pose.pose.pose)[:3, 3])
    assert off_m < 0.05 < 0.15 < np.linalg.norm(frames[-1][1][:3, 3])
    assert np.diag(np.reshape(pose.pose.covariance, (6, 6))).min() > 0.0
    correction = robot.heard["map_to_odom"][-1]
    assert (correction.header.frame_id, correction.child_frame_id) == ("map", "odom")
    T_map_camera = transform_matrix(correction.transform) @ frames[-1][1]
    assert np.linalg.norm(T_map_camera[:3, 3]) < 0.05
    assert len(robot.markers()["loops"].points) >= 2
    cells = np.array(robot.heard["map"][-1].data)
    assert {-1, 0, 100} == set(cells.tolist())
    assert robot.heard["cloud"][-1].width > 1000
    # The first may be missed: the listener may still be looking for the node then.
    keyframes = {seconds(pose.header.stamp) for pose in robot.heard["path"][-1].poses[3:]}
    robot.wait_until(
        lambda: keyframes <= {seconds(cloud.header.stamp) for cloud in robot.heard["cloud"]}
    )
    scene = json.loads(robot.heard["scene"][-1].data)
    assert scene["label"] in {*scene["probabilities"], "unknown"}
    message = robot.call("save")
    assert "saved.db" in message
    with MapStore.open(robot.map_file.with_suffix(".saved.db")) as saved:
        assert np.isfinite(saved.map_poses()).all()
        assert saved.sessions()[0].is_finished
    assert robot.call("finish").startswith(f"{len(frames)} frames in")
    expected = LoopCloser.from_config(override(preset("indoor"), [UPRIGHT]))
    for frame, T in frames:
        expected.process(frame, T)
    expected.finish()
    assert loops_in(robot.map_file) == {
        (loop.query_id, loop.match_id) for loop in expected.map.loops
    }
    node.send_signal(signal.SIGINT)
    robot.wait_until(lambda: node.poll() is not None)


def test_a_node_that_was_killed_goes_on_from_its_map_with_odometry_started_anew(
    robot: Robot, frames: list[tuple[DepthFrame, Pose]]
) -> None:
    node = robot.start()
    robot.play(frames[:12])
    robot.wait_until(lambda: robot.n_frames() == 12)
    node.kill()
    node.wait()
    robot.heard["map_to_odom"].clear()
    robot.heard["diagnostics"].clear()
    robot.start()
    again = [(frame, se3.inverse(frames[20][1]) @ T) for frame, T in frames[20:]]
    robot.play(again)
    robot.wait_until(lambda: robot.n_frames() == len(again))
    robot.wait_until(lambda: bool(robot.heard["map_to_odom"]))
    robot.call("finish")
    with MapStore.open(robot.map_file) as store:
        assert [session.is_finished for session in store.sessions()] == [True, True]
        of_session = [keyframe.session for keyframe in store.keyframes()]
    loops = loops_in(robot.map_file)
    assert any((of_session[q], of_session[m]) == (1, 0) for q, m in loops)
