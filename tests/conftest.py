"""Fixtures that many tests share."""

from __future__ import annotations

import os
import runpy
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings
from numpy.typing import NDArray
from web_server import Server, serving

from slam_bof.geometry import se3
from slam_bof.synthetic import KINECT, Scene3D, distance_to_boxes, make_room, sense
from slam_bof.synthetic.rooms import Room
from slam_bof.synthetic.writer import write_sequence
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose

# No test is timed: machines may be slow, or busy with other work.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

collect_ignore = ["plugins/ros/player.py", "plugins/ros/robot.py"]
"""Files that need ROS, which pytest would import to look for doctests."""

ROOT = Path(__file__).resolve().parent.parent

CAMERA = Intrinsics(160, 120, 146.25, 146.25, 80.0, 60.0)
"""The 7-Scenes depth camera at a quarter of its size."""


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of real data beside the checkout; skips where there is none."""
    path = Path(os.environ.get("SLAM_BOF_SHARED_DATA", ROOT.parent / "shared" / "data"))
    if not path.is_dir():
        pytest.skip(f"needs real data: no folder {path}, and SLAM_BOF_SHARED_DATA is not set")
    return path


@pytest.fixture
def server() -> Iterator[Server]:
    """A web server on this machine that has no files yet."""
    with serving() as state:
        yield state


def box_room_depth_mm(
    camera: Intrinsics, T_world_camera: Array, half_size_m: tuple[float, float, float] = (2, 1.5, 3)
) -> NDArray[np.uint16]:
    """Return the depth (H, W) in mm that a camera sees inside an axis-aligned box around 0.

    Exact but for the rounding to mm: each ray leaves the box through the nearest of the three
    walls that it goes towards.
    """
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays_camera = np.stack(
        [(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1
    )
    rays_world = rays_camera @ T_world_camera[:3, :3].T
    with np.errstate(divide="ignore"):
        walls = np.copysign(half_size_m, rays_world)
        depth_m = ((walls - T_world_camera[:3, 3]) / rays_world).min(axis=-1, initial=np.inf)
    return np.round(1000 * depth_m).astype(np.uint16)


@pytest.fixture
def box_room_frame() -> DepthFrame:
    """A depth frame from the middle of a box room."""
    return DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)


Look = Callable[[Pose, int], DepthFrame]


@pytest.fixture(scope="session")
def room() -> Room:
    return make_room("living_room", seed=3)


@pytest.fixture(scope="session")
def look(room: Room) -> Look:
    """Look into the room from T_world_camera, through the sensor model; frames at 30 Hz."""
    scene = Scene3D(room.mesh)

    def view(T_world_camera: Pose, index: int = 0) -> DepthFrame:
        seen = scene.view(T_world_camera)
        depth = sense(seen.depth_m, seen.returned, np.random.default_rng(index))
        return DepthFrame(index / 30.0, depth, KINECT)

    return view


@pytest.fixture(scope="session")
def standpoint(room: Room) -> tuple[float, float]:
    """The place nearest to the middle of the room that furniture leaves free."""
    width, depth, _ = room.size
    x, y = np.meshgrid(np.linspace(0.6, width - 0.6, 25), np.linspace(0.6, depth - 0.6, 25))
    places = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.3)], axis=1)
    free = places[distance_to_boxes(places, room.boxes).min(axis=1) > 0.3]
    off_m = np.linalg.norm(free[:, :2] - [width / 2, depth / 2], axis=1)
    return tuple(free[int(np.argmin(off_m))][:2])


@pytest.fixture(scope="session")
def walk(look: Look, standpoint: tuple[float, float]) -> list[tuple[DepthFrame, Pose]]:
    """Two looks about on the spot, (frame, T_odom_camera) each, so that there are loops."""
    yaws = np.tile(np.arange(0.0, 2.0, 0.1), 2)
    poses = np.tile(np.eye(4), (len(yaws), 1, 1))
    for pose, yaw in zip(poses, yaws, strict=True):
        c, s = np.cos(yaw), np.sin(yaw)
        pose[:3] = [[s, 0, c, standpoint[0]], [-c, 0, s, standpoint[1]], [0, -1, 0, 1.3]]
    return [
        (replace(look(T, k), stamp_s=k / 10 + 4.0 * (k // 20)), se3.inverse(poses[0]) @ T)
        for k, T in enumerate(poses)
    ]


@pytest.fixture(scope="session")
def write_turn(room: Room, standpoint: tuple[float, float]) -> Callable[..., None]:
    """Write what a level camera sees of the room, in 7-Scenes layout, at each yaw (and x)."""
    scene = Scene3D(room.mesh)

    def write(folder: Path, yaws: list[float], beside_m: list[float] | None = None) -> None:
        poses = np.tile(np.eye(4), (len(yaws), 1, 1))
        for pose, yaw, x in zip(poses, yaws, beside_m or [0.0] * len(yaws), strict=True):
            c, s = np.cos(yaw), np.sin(yaw)
            pose[:3] = [
                [s, 0, c, standpoint[0] + x],
                [-c, 0, s, standpoint[1]],
                [0, -1, 0, 1.3],
            ]
        write_sequence(folder, scene, poses)

    return write


@pytest.fixture(scope="module")
def load_script():
    """Load a script of the folder by name, with the modules that the scripts share."""
    scripts = ROOT / "scripts"
    sys.path.insert(0, str(scripts))
    yield lambda name: runpy.run_path(str(scripts / name))
    sys.path.remove(str(scripts))
