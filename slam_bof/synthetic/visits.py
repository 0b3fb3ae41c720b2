"""Paths that visit the rooms along a hallway and look around in each."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slam_bof.synthetic.rooms import DOOR_HEIGHT_M, DOOR_WIDTH_M
from slam_bof.synthetic.tour import Waypoint
from slam_bof.synthetic.walls import WALL_THICKNESS_M, Opening
from slam_bof.types import Array

__all__ = ["RoomPlace", "clear_columns", "doorway", "visit", "visit_all"]


@dataclass(frozen=True, slots=True, eq=False)
class RoomPlace:
    """The place of a room: its kind, and its low and high corner (2,) on the floor.

    ``door`` (2,) is the middle of its door on the room's side, ``inward`` +1 where the room
    lies north of the hallway and -1 where it lies south.
    """

    kind: str
    low: Array
    high: Array
    door: Array
    inward: int

    def holds(self, x: float, y: float) -> bool:
        """Return whether a point of the floor is in the room."""
        return bool((self.low <= (x, y)).all() and ((x, y) <= self.high).all())


def doorway(wall: int, x: float) -> Opening:
    """Return the opening between a hallway and a room, for the wall of either."""
    return Opening(wall, x, DOOR_WIDTH_M, 0.0, DOOR_HEIGHT_M, "open")


def visit(room: RoomPlace, hall_width_m: float) -> list[Waypoint]:
    """Enter from the hallway, look to one side, then around to the other, and leave."""
    x, y = room.door
    n = room.inward
    ahead = n * np.pi / 2
    # The long sweep is towards the larger side, which shows more than a near wall.
    side = 1.0 if room.high[0] - x > x - room.low[0] else -1.0
    turn = n * side
    hall = y - n * (2 * WALL_THICKNESS_M + hall_width_m / 2)
    return [
        Waypoint(x, hall, ahead, pitch=0.2),
        Waypoint(x, y + 0.4 * n, ahead, pitch=0.25),
        Waypoint(x + 0.2 * side, y + 1.4 * n, ahead + turn * 0.4, pitch=0.35),
        Waypoint(x - 0.1 * side, y + 1.45 * n, ahead - turn * 0.8, pitch=0.35),
        Waypoint(x, y + 1.1 * n, ahead - turn * 2.4, pitch=0.3),
        Waypoint(x, y + 0.4 * n, ahead - turn * np.pi, pitch=0.2),
        Waypoint(x, hall, ahead - turn * np.pi, pitch=0.2),
    ]


def visit_all(rooms: Iterable[RoomPlace], hall_width_m: float) -> list[Waypoint]:
    """Visit rooms in their order, walking along the hallway between them."""
    waypoints: list[Waypoint] = []
    for room in rooms:
        there = visit(room, hall_width_m)
        if waypoints:
            last = waypoints[-1]
            leg = there[0].x - last.x
            if abs(leg) > 1.0:  # along the hallway the camera looks ahead
                ahead = _unwrapped(0.0 if leg > 0 else np.pi, last.yaw)
                waypoints += [
                    Waypoint(last.x + 0.25 * leg, last.y, ahead, pitch=0.2),
                    Waypoint(last.x + 0.75 * leg, last.y, ahead, pitch=0.2),
                ]
            shift = _unwrapped(there[0].yaw, waypoints[-1].yaw) - there[0].yaw
            there = [Waypoint(w.x, w.y, w.yaw + shift, w.z, w.pitch) for w in there]
        waypoints += there
    return waypoints


def clear_columns(path: Array, radius: float) -> Array:
    """Return columns (K, 4) every 0.1 m along a path (M, 2), which furniture leaves free."""
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    along = np.arange(0.0, length[-1] + 0.1, 0.1)
    x, y = np.interp(along, length, path[:, 0]), np.interp(along, length, path[:, 1])
    return np.stack([x, y, np.zeros_like(x), np.full_like(x, radius)], axis=1)


def _unwrapped(yaw: float, near: float) -> float:
    """Return the same direction as ``yaw``, within half a turn of ``near``."""
    return yaw + 2 * np.pi * round((near - yaw) / (2 * np.pi))
