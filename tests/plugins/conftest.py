from collections.abc import Callable

import numpy as np
import pytest

from slam_bof.synthetic import KINECT, Scene3D, make_room, sense
from slam_bof.synthetic.furnisher import distance_to_boxes
from slam_bof.synthetic.rooms import Room
from slam_bof.types import DepthFrame, Pose

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
