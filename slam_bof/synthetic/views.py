"""Random hand-held views in random rooms, as training data."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from slam_bof.synthetic.furnisher import distance_to_boxes
from slam_bof.synthetic.rooms import Room, make_room
from slam_bof.synthetic.scene import Scene3D, View
from slam_bof.synthetic.sensor import SensorModelParams, sense
from slam_bof.synthetic.tour import FRAME_RATE_HZ, camera_poses
from slam_bof.types import Array, DepthFrame, Intrinsics, Pose

__all__ = ["furnished_views", "messy_views", "shaded_views", "training_views"]

_TRIES = 200
_ELONGATED = 2.5
"""Ratio of length to width of a messy room from which three of four views look along it."""
_SMALL_CAMERA = Intrinsics(320, 240, 285.0, 285.0, 159.5, 119.5)


def training_views(
    kind: str, seed: int, n_views: int, *, sensor: SensorModelParams | None = None
) -> Iterator[DepthFrame]:
    """Yield views from random viewpoints in one random room.

    Parameters
    ----------
    kind
        One of ``ROOM_KINDS``.
    seed
        Seed of room, viewpoints and noise.
    n_views
        Number of views.
    sensor
        Parameters of the depth camera.

    Yields
    ------
    DepthFrame
        640x480 uint16 millimetres. Eyes are 1.1 to 1.7 m high, half a metre from furniture,
        and look at nothing nearer than 0.6 m.
    """
    for frame, _ in _views(kind, seed, n_views, sensor):
        yield frame


def shaded_views(
    kind: str, seed: int, n_views: int, *, sensor: SensorModelParams | None = None
) -> Iterator[tuple[DepthFrame, NDArray[np.uint8]]]:
    """Yield the same views, each with the shading of its surfaces, (480, 640) grey.

    It is the grey image of a camera with a lamp if all surfaces have one colour.
    """
    for frame, view in _views(kind, seed, n_views, sensor):
        shade = 255.0 * view.cosine * (view.depth_m > 0)
        yield frame, shade.astype(np.uint8)


def messy_views(kind: str, seed: int, n_views: int) -> Iterator[tuple[DepthFrame, Array]]:
    """Yield exact views of one random messy room, each with gravity in the camera frame.

    The images are 320x240 float metres without a sensor's errors. Eyes are 0.8 to 1.9 m high. Who
    walks along a corridor mostly looks along it.
    Parameters are those of ``training_views``.
    """
    room = make_room(kind, seed, messy=True)
    scene = Scene3D(room.mesh, _SMALL_CAMERA)
    rng = np.random.default_rng([seed, 12])
    is_elongated = bool(room.size[1] > _ELONGATED * room.size[0])
    for i in range(n_views):
        T_world_camera, view = _look(room, scene, rng, (0.8, 1.9), along=is_elongated)
        gravity_camera = T_world_camera[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        yield DepthFrame(i / FRAME_RATE_HZ, view.depth_m, scene.intrinsics), gravity_camera


def furnished_views(
    kind: str, seed: int, n_views: int, *, messy: bool
) -> Iterator[tuple[DepthFrame, Array, NDArray[np.uint8]]]:
    """Yield exact views of one random room, each with gravity and the furniture in it.

    Images and viewpoints are like those of ``messy_views``, with heights of ``training_views``
    where the room is not messy. The third item (240, 320) is the kind of furniture that a pixel
    shows, by its number in ``PIECES``. Parameters are those of ``training_views`` and
    ``make_room``.
    """
    room = make_room(kind, seed, messy=messy)
    scene = Scene3D(room.mesh, _SMALL_CAMERA)
    rng = np.random.default_rng([seed, 21])
    heights_m = (0.8, 1.9) if messy else (1.1, 1.7)
    is_elongated = bool(room.size[1] > _ELONGATED * room.size[0])
    for i in range(n_views):
        T_world_camera, view = _look(room, scene, rng, heights_m, along=is_elongated)
        gravity_camera = T_world_camera[:3, :3].T @ np.array([0.0, 0.0, -1.0])
        frame = DepthFrame(i / FRAME_RATE_HZ, view.depth_m, scene.intrinsics)
        pieces = np.where(view.triangle >= 0, room.pieces[view.triangle], 0)
        yield frame, gravity_camera, pieces.astype(np.uint8)


def _views(
    kind: str, seed: int, n_views: int, sensor: SensorModelParams | None
) -> Iterator[tuple[DepthFrame, View]]:
    room = make_room(kind, seed)
    scene = Scene3D(room.mesh)
    rng = np.random.default_rng([seed, 11])
    for i in range(n_views):
        _, view = _look(room, scene, rng)
        depth = sense(view.depth_m, view.returned, rng, sensor)
        yield DepthFrame(i / FRAME_RATE_HZ, depth, scene.intrinsics), view


def _look(
    room: Room,
    scene: Scene3D,
    rng: np.random.Generator,
    heights_m: tuple[float, float] = (1.1, 1.7),
    *,
    along: bool = False,
) -> tuple[Pose, View]:
    """Choose a viewpoint that shows the room and nothing too near."""
    for _ in range(_TRIES):
        T_world_camera = _viewpoint(room, rng, heights_m, along=along)
        view = scene.view(T_world_camera)
        seen = view.depth_m[::8, ::8]
        near = np.percentile(seen[seen > 0], 15) if (seen > 0).any() else 0.0
        if near > 0.6 and np.mean(seen > 0) > 0.5:
            break
    return T_world_camera, view


def _viewpoint(
    room: Room, rng: np.random.Generator, heights_m: tuple[float, float], *, along: bool
) -> Pose:
    """Choose a free place in the room and a direction, most often across (or along) the room."""
    width, depth, _ = room.size
    best, best_room = np.zeros(3), -1.0
    for _ in range(_TRIES):
        x, y = rng.uniform((0.35, 0.35), (width - 0.35, depth - 0.35))
        z = rng.uniform(*heights_m)
        point = np.array([[x, y, z]])
        free = distance_to_boxes(point, room.boxes).min() if len(room.boxes) else np.inf
        if free > best_room:
            best, best_room = point[0], free
        if free > 0.35:
            break
    across = np.arctan2(depth / 2 - best[1], width / 2 - best[0])
    yaw = across + rng.normal(0.0, 1.2)
    if along and rng.random() < 0.75:
        yaw = rng.choice([-1.0, 1.0]) * np.pi / 2 + rng.normal(0.0, 0.35)
    return camera_poses(best, yaw, rng.normal(0.25, 0.18), rng.normal(0.0, 0.05))
