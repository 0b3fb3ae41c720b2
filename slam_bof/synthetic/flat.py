"""A furnished flat with four rooms along a hallway, and a tour that returns to its start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_bof.synthetic.meshes import Mesh, merge
from slam_bof.synthetic.rooms import make_room
from slam_bof.synthetic.tour import TURN_RATE, walk
from slam_bof.synthetic.visits import RoomPlace, clear_columns, doorway, visit, visit_all
from slam_bof.synthetic.walls import WALL_THICKNESS_M, Opening
from slam_bof.types import Array

__all__ = ["Flat", "make_flat", "make_tour"]

_HALL_LENGTH_M, _HALL_WIDTH_M, _HEIGHT_M = 5.9, 1.95, 2.5
_DOORS_X_M = (1.45, 4.45)
_VISITS = (0, 1, 2, 3, 0)


@dataclass(frozen=True, slots=True, eq=False)
class Flat:
    """One mesh of a hallway and its rooms, in the world frame (z up)."""

    mesh: Mesh
    rooms: tuple[RoomPlace, ...]

    def kind_at(self, x: float, y: float) -> str:
        """Return the kind of the room that holds the point; ``corridor`` between rooms."""
        for room in self.rooms:
            if room.holds(x, y):
                return room.kind
        return "corridor"


def make_flat(seed: int = 0) -> Flat:
    """Build a flat of four furnished rooms of different kinds along a hallway.

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
        openings = [doorway(0 if inward > 0 else 2, door)]
        if kind != "bathroom":
            openings.append(Opening(2 if inward > 0 else 0, width / 2, 1.2, 0.95, 2.1, "window"))
        path = np.array([(w.x, w.y) for w in visit(place, _HALL_WIDTH_M)])
        room = make_room(
            kind,
            seed,
            size=(width, depth, _HEIGHT_M),
            openings=openings,
            clear=clear_columns(path - low, 0.5),
        )
        places.append(place)
        meshes.append(room.mesh.placed(low[0], low[1]))
        hall_doors.append(doorway(2, _HALL_LENGTH_M - x) if inward > 0 else doorway(0, x))
    middle = _HALL_WIDTH_M / 2
    hall = make_room(
        "corridor",
        seed,
        size=(_HALL_LENGTH_M, _HALL_WIDTH_M, _HEIGHT_M),
        openings=hall_doors,
        clear=clear_columns(np.array([(_DOORS_X_M[0], middle), (_DOORS_X_M[1], middle)]), 0.45),
    )
    return Flat(merge([hall.mesh, *meshes]), tuple(places))


def make_tour(flat: Flat, *, seed: int = 0, turn_rate: float = TURN_RATE) -> Array:
    """Walk through all rooms and back into the first, with a hand-held camera.

    Parameters
    ----------
    flat
        The flat.
    seed
        Seed of the tremor.
    turn_rate
        Largest yaw rate in rad/s, without tremor.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``: by default under 4 cm and 2.5 degrees
        between frames.
    """
    waypoints = visit_all([flat.rooms[i] for i in _VISITS], _HALL_WIDTH_M)
    return walk(waypoints[:-2], turn_rate=turn_rate, seed=seed)
