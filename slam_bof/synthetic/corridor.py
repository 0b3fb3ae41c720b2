"""A corridor of identical rooms, where one place looks like another."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_bof.synthetic.meshes import Mesh, box, merge
from slam_bof.synthetic.rooms import make_room
from slam_bof.synthetic.tour import walk
from slam_bof.synthetic.visits import RoomPlace, clear_columns, doorway, visit, visit_all
from slam_bof.synthetic.walls import WALL_THICKNESS_M, Opening
from slam_bof.synthetic.writer import Progress, write_scene
from slam_bof.types import Array

__all__ = ["Corridor", "make_corridor", "make_corridor_tour", "write_corridor"]

_WIDTH_M, _DEPTH_M, _HEIGHT_M = 3.9, 4.2, 2.5
_HALL_WIDTH_M = 1.95
_DOOR_X_M = 1.6
_PITCH_M = _WIDTH_M + 2 * WALL_THICKNESS_M
_ROOM_KIND = "office"
_GENERATION = 1


@dataclass(frozen=True, slots=True, eq=False)
class Corridor:
    """One mesh of equal bays side by side along x, each a room and the hallway before its door.

    World frame: z up. ``pitch_m`` is the distance from one bay to the next.
    """

    mesh: Mesh
    rooms: tuple[RoomPlace, ...]
    pitch_m: float


def make_corridor(n_rooms: int = 4, *, seed: int = 0) -> Corridor:
    """Build a corridor with ``n_rooms`` exactly identical rooms.

    Archways divide the hallway into identical bays too. Only its two ends, where the archway is
    walled up, differ.

    Parameters
    ----------
    n_rooms
        At least one.
    seed
        Seed of the furniture.

    Raises
    ------
    ValueError
        If ``n_rooms`` is below one.
    """
    if n_rooms < 1:
        raise ValueError(f"a corridor needs at least 1 room, got {n_rooms}")
    edge = _HALL_WIDTH_M + 2 * WALL_THICKNESS_M
    first = _place(0, edge)
    path = np.array([(w.x, w.y) for w in visit(first, _HALL_WIDTH_M)])
    room = make_room(
        _ROOM_KIND,
        seed,
        size=(_WIDTH_M, _DEPTH_M, _HEIGHT_M),
        openings=[doorway(0, _DOOR_X_M), Opening(2, _WIDTH_M / 2, 1.2, 0.95, 2.1, "window")],
        clear=clear_columns(path - first.low, 0.5),
    )
    middle = _HALL_WIDTH_M / 2
    hall = make_room(
        "corridor",
        seed,
        size=(_WIDTH_M, _HALL_WIDTH_M, _HEIGHT_M),
        openings=[doorway(2, _WIDTH_M - _DOOR_X_M), _archway(1), _archway(3)],
        clear=clear_columns(np.array([(0.0, middle), (_WIDTH_M, middle)]), 0.45),
    )
    bay = merge([hall.mesh, room.mesh.placed(*first.low)])
    end_x = (n_rooms - 1) * _PITCH_M + _WIDTH_M
    t = WALL_THICKNESS_M
    ends = [
        box(x, 0.0, 0.0, x + 0.02, _HALL_WIDTH_M, _HEIGHT_M, (0.8, 0.8, 0.75))
        for x in (-t - 0.02, end_x + t)
    ]
    return Corridor(
        merge([*(bay.placed(i * _PITCH_M, 0.0) for i in range(n_rooms)), *ends]),
        tuple(_place(i, edge) for i in range(n_rooms)),
        _PITCH_M,
    )


def make_corridor_tour(corridor: Corridor, *, seed: int = 0) -> Array:
    """Visit every room in turn, then all but the last in reverse order, in the same manner.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``.
    """
    there = list(corridor.rooms)
    return walk(visit_all(there + there[-2::-1], _HALL_WIDTH_M), seed=seed)


def write_corridor(
    folder: Path, *, n_rooms: int = 4, seed: int = 0, progress: Progress | None = None
) -> Path:
    """Write ``folder/corridor/seq-01`` in 7-Scenes layout, unless it exists.

    Parameters
    ----------
    folder
        Parent of the scene folder ``corridor``, created if missing.
    n_rooms
        Number of rooms; see ``make_corridor``.
    seed
        Seed of furniture, tour and sensor noise. The same seed gives the same bytes.
    progress
        Called after each frame.

    Returns
    -------
    Path
        The sequence's folder.

    Raises
    ------
    DatasetError
        If ``folder/corridor`` exists and was not written by this function.
    """
    corridor = make_corridor(n_rooms, seed=seed)
    poses = make_corridor_tour(corridor, seed=seed)
    return write_scene(
        folder / "corridor",
        "seq-01",
        corridor.mesh,
        poses,
        recipe={"generation": _GENERATION, "kind": "corridor", "seed": seed, "n_rooms": n_rooms},
        seed=seed,
        progress=progress,
    )


def _place(number: int, edge: float) -> RoomPlace:
    """Return the place of a room whose door is at the north edge of the hallway."""
    low = np.array((number * _PITCH_M, edge))
    high = low + np.array((_WIDTH_M, _DEPTH_M))
    return RoomPlace(_ROOM_KIND, low, high, low + np.array((_DOOR_X_M, 0.0)), 1)


def _archway(wall: int) -> Opening:
    return Opening(wall, _HALL_WIDTH_M / 2, 1.4, 0.0, 2.2, "open")
