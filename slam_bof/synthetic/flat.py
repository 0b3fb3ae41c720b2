"""A furnished flat: four rooms off a hallway, and a tour through it that comes back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_bof.synthetic.meshes import Mesh, merge
from slam_bof.synthetic.rooms import DOOR_HEIGHT_M, DOOR_WIDTH_M, make_room
from slam_bof.synthetic.tour import Waypoint, walk
from slam_bof.synthetic.walls import WALL_THICKNESS_M, Opening
from slam_bof.types import Array

__all__ = ["Flat", "RoomPlace", "make_flat", "make_tour"]

_HALL_LENGTH_M, _HALL_WIDTH_M, _HEIGHT_M = 5.9, 1.95, 2.5
_DOORS_X_M = (1.45, 4.45)
_VISITS = (0, 1, 2, 3, 0)


@dataclass(frozen=True, slots=True, eq=False)
class RoomPlace:
    """Where a room of the flat is: its kind, low and high corner (2,) on the floor.

    ``door`` (2,) is the middle of its door on the room's side, ``inward`` +1 where the room
    lies north of the hallway and -1 where it lies south.
    """

    kind: str
    low: Array
    high: Array
    door: Array
    inward: int


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """One mesh of a hallway and its rooms, in the world frame (z up)."""

    mesh: Mesh
    rooms: tuple[RoomPlace, ...]

    def kind_at(self, x: float, y: float) -> str:
        """Return the kind of the room that holds the point; ``corridor`` between rooms."""
        for room in self.rooms:
            if (room.low <= (x, y)).all() and ((x, y) <= room.high).all():
                return room.kind
        return "corridor"


def make_flat(seed: int = 0) -> Flat:
    """Build a flat of four furnished rooms of different kinds off a hallway.

    Parameters
    ----------
    seed
        Chooses room sizes and furniture; the same seed gives the same flat.
    """
    rng = np.random.default_rng([seed, 7])
    sizes = {
        "living_room": (rng.uniform(3.6, 3.8), rng.uniform(3.8, 4.3)),
        "kitchen": (rng.uniform(3.2, 3.5), rng.uniform(3.4, 3.8)),
        "bedroom": (rng.uniform(3.3, 3.7), rng.uniform(3.6, 4.0)),
        "bathroom": (rng.uniform(2.7, 2.9), rng.uniform(3.0, 3.3)),
    }
    spots = (
        ("living_room", 0, -1),
        ("kitchen", 0, 1),
        ("bedroom", 1, 1),
        ("bathroom", 1, -1),
    )
    places, meshes, hall_doors = [], [], []
    for kind, side, inward in spots:
        width, depth = sizes[kind]
        x = _DOORS_X_M[side]
        x0 = x + 1.35 - width if side == 0 else x - 1.35
        edge = _HALL_WIDTH_M + 2 * WALL_THICKNESS_M if inward > 0 else -2 * WALL_THICKNESS_M
        low = np.array((x0, edge if inward > 0 else edge - depth))
        place = RoomPlace(kind, low, low + np.array((width, depth)), np.array((x, edge)), inward)
        door = (x - x0) if inward > 0 else width - (x - x0)
        openings = [_door(0 if inward > 0 else 2, door)]
        if kind != "bathroom":
            openings.append(Opening(2 if inward > 0 else 0, width / 2, 1.2, 0.95, 2.1, "window"))
        path = np.array([(w.x, w.y) for w in _visit(place)])
        room = make_room(
            kind,
            seed,
            size=(width, depth, _HEIGHT_M),
            openings=openings,
            clear=_clear(path - low, 0.5),
        )
        places.append(place)
        meshes.append(room.mesh.placed(low[0], low[1]))
        hall_doors.append(_door(2, _HALL_LENGTH_M - x) if inward > 0 else _door(0, x))
    middle = _HALL_WIDTH_M / 2
    hall = make_room(
        "corridor",
        seed,
        size=(_HALL_LENGTH_M, _HALL_WIDTH_M, _HEIGHT_M),
        openings=hall_doors,
        clear=_clear(np.array([(_DOORS_X_M[0], middle), (_DOORS_X_M[1], middle)]), 0.45),
    )
    return Flat(merge([hall.mesh, *meshes]), tuple(places))


def make_tour(flat: Flat, *, seed: int = 0) -> Array:
    """Walk through all rooms and back into the first, as with a camera in the hands.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``: under 4 cm and 2.5 degrees between
        frames.
    """
    waypoints: list[Waypoint] = []
    for room in (flat.rooms[i] for i in _VISITS):
        visit = _visit(room)
        if waypoints:
            last = waypoints[-1]
            leg = visit[0].x - last.x
            if abs(leg) > 1.0:  # along the hallway one looks where one goes
                ahead = _unwrapped(0.0 if leg > 0 else np.pi, last.yaw)
                waypoints += [
                    Waypoint(last.x + 0.25 * leg, last.y, ahead, pitch=0.2),
                    Waypoint(last.x + 0.75 * leg, last.y, ahead, pitch=0.2),
                ]
            shift = _unwrapped(visit[0].yaw, waypoints[-1].yaw) - visit[0].yaw
            visit = [Waypoint(w.x, w.y, w.yaw + shift, w.z, w.pitch) for w in visit]
        waypoints += visit
    return walk(waypoints[:-2], seed=seed)


def _unwrapped(yaw: float, near: float) -> float:
    """Return the same direction as ``yaw``, within half a turn of ``near``."""
    return yaw + 2 * np.pi * round((near - yaw) / (2 * np.pi))


def _door(wall: int, x: float) -> Opening:
    return Opening(wall, x, DOOR_WIDTH_M, 0.0, DOOR_HEIGHT_M, "open")


def _visit(room: RoomPlace) -> list[Waypoint]:
    """Go in from the hallway, look to one side, then all round the other, and out again."""
    x, y = room.door
    n = room.inward
    ahead = n * np.pi / 2
    # The long sweep goes over the side with more room: it shows more than a wall close by.
    side = 1.0 if room.high[0] - x > x - room.low[0] else -1.0
    turn = n * side
    hall = y - n * (2 * WALL_THICKNESS_M + _HALL_WIDTH_M / 2)
    return [
        Waypoint(x, hall, ahead, pitch=0.2),
        Waypoint(x, y + 0.4 * n, ahead, pitch=0.25),
        Waypoint(x + 0.2 * side, y + 1.4 * n, ahead + turn * 0.4, pitch=0.35),
        Waypoint(x - 0.1 * side, y + 1.45 * n, ahead - turn * 0.8, pitch=0.35),
        Waypoint(x, y + 1.1 * n, ahead - turn * 2.4, pitch=0.3),
        Waypoint(x, y + 0.4 * n, ahead - turn * np.pi, pitch=0.2),
        Waypoint(x, hall, ahead - turn * np.pi, pitch=0.2),
    ]


def _clear(path: Array, radius: float) -> Array:
    """Return columns (K, 4) every 0.1 m along a path (M, 2)."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    along = np.arange(0.0, length[-1] + 0.1, 0.1)
    x, y = np.interp(along, length, path[:, 0]), np.interp(along, length, path[:, 1])
    return np.stack([x, y, np.zeros_like(x), np.full_like(x, radius)], axis=1)
