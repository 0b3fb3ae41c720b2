"""Rooms of several kinds, each furnished in its own way from a seed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from slam_bof.synthetic import furniture as f
from slam_bof.synthetic.furnisher import Furnisher
from slam_bof.synthetic.meshes import Mesh, merge
from slam_bof.synthetic.walls import Opening, shell, wall_length
from slam_bof.types import Array

__all__ = ["FIRST_KINDS", "PIECES", "ROOM_KINDS", "Room", "make_room"]

DOOR_WIDTH_M = 0.92
DOOR_HEIGHT_M = 2.05


@dataclass(frozen=True, slots=True, eq=False)
class Room:
    """A furnished room: its corner at the origin, ``size`` (3,), ``boxes`` (K, 2, 3) in the way.

    ``pieces`` (F,) is the kind of furniture that each triangle is of, by its number in ``PIECES``.
    """

    kind: str
    size: Array
    mesh: Mesh
    boxes: Array
    pieces: NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, np.uint8))


def _kitchen(p: Furnisher) -> None:
    p.in_corner(f.counter)
    p.in_corner(f.fridge)
    p.against_wall(f.stove)
    p.against_wall(f.counter)
    p.free_standing(f.dining_set, chance=0.8)
    p.against_wall(f.bin_, n=2)
    p.against_wall(f.wall_shelf, n=2, chance=0.7)
    p.against_wall(f.chair, chance=0.6)
    p.against_wall(f.boxes, chance=0.5)
    p.against_wall(f.picture, n=2)


def _office(p: Furnisher) -> None:
    p.against_wall(f.desk, n=2)
    p.against_wall(f.bookshelf, n=2)
    p.against_wall(f.desk, chance=0.5)
    p.against_wall(f.cabinet, n=2, chance=0.8)
    p.against_wall(f.whiteboard)
    p.in_corner(f.plant, chance=0.6)
    p.against_wall(f.bin_, n=2)
    p.against_wall(f.boxes, n=2, chance=0.6)
    p.free_standing(f.office_chair, chance=0.5)
    p.against_wall(f.picture, n=2)


def _bedroom(p: Furnisher) -> None:
    p.against_wall(f.bed)
    p.against_wall(f.wardrobe)
    p.against_wall(f.nightstand, n=2)
    p.against_wall(f.cabinet)
    p.against_wall(f.wardrobe, chance=0.5)
    p.in_corner(f.floor_lamp, chance=0.6)
    p.against_wall(f.chair, chance=0.7)
    p.against_wall(f.bookshelf, chance=0.3)
    p.against_wall(f.picture, n=3)
    p.against_wall(f.boxes, chance=0.5)


def _bathroom(p: Furnisher) -> None:
    p.in_corner(f.bathtub)
    p.against_wall(f.toilet)
    p.against_wall(f.wash_basin)
    p.against_wall(f.washing_machine, chance=0.8)
    p.in_corner(f.shower, chance=0.5)
    p.against_wall(f.towel_rail)
    p.against_wall(f.wash_basin, chance=0.3)
    p.against_wall(f.wall_shelf, n=2, chance=0.6)
    p.against_wall(f.bin_, n=2)


def _living_room(p: Furnisher) -> None:
    p.against_wall(f.sofa)
    p.against_wall(f.tv_stand)
    p.against_wall(f.armchair)
    p.free_standing(f.coffee_table)
    p.against_wall(f.bookshelf, n=2, chance=0.8)
    p.against_wall(f.sofa, chance=0.4)
    p.in_corner(f.floor_lamp)
    p.in_corner(f.plant, n=2, chance=0.8)
    p.against_wall(f.armchair, chance=0.5)
    p.against_wall(f.wall_shelf, chance=0.7)
    p.against_wall(f.picture, n=3)


def _corridor(p: Furnisher) -> None:
    p.against_wall(f.coat_rack)
    p.against_wall(f.console)
    p.against_wall(f.shoe_rack)
    p.against_wall(f.wall_cabinet, n=2)
    p.against_wall(f.picture, n=3)
    p.against_wall(f.wall_shelf, n=2, chance=0.6)
    p.in_corner(f.plant, chance=0.6)
    p.against_wall(f.boxes, n=2, chance=0.6)
    p.against_wall(f.shoe_rack, chance=0.5)
    p.against_wall(f.coat_rack, chance=0.4)
    p.against_wall(f.bin_, chance=0.5)


def _meeting_room(p: Furnisher) -> None:
    p.free_standing(f.conference_set, margin=0.9)
    p.against_wall(f.whiteboard, n=2)
    p.against_wall(f.cabinet, n=2)
    p.in_corner(f.plant, n=2, chance=0.7)
    p.against_wall(f.tv_stand, chance=0.5)
    p.against_wall(f.chair, n=3, chance=0.7)
    p.against_wall(f.picture, n=2)
    p.against_wall(f.bin_)


def _dining_room(p: Furnisher) -> None:
    p.free_standing(f.banquet_set)
    p.against_wall(f.cabinet)
    p.against_wall(f.console, chance=0.6)
    p.against_wall(f.cabinet, chance=0.5)
    p.in_corner(f.plant, n=2, chance=0.5)
    p.against_wall(f.chair, n=2, chance=0.5)
    p.in_corner(f.floor_lamp, chance=0.3)
    p.against_wall(f.picture, n=3)


def _classroom(p: Furnisher) -> None:
    p.against_wall(f.whiteboard, n=2)
    p.free_standing(f.desk_rows, margin=0.7)
    p.against_wall(f.cabinet, n=2, chance=0.6)
    p.against_wall(f.bookshelf, chance=0.5)
    p.against_wall(f.chair, n=3, chance=0.5)
    p.against_wall(f.picture, n=2)
    p.against_wall(f.bin_)


def _filler(rng: np.random.Generator) -> Mesh:
    """Make one of the pieces that occur in rooms of all kinds."""
    makers = (f.picture, f.wall_shelf, f.wall_cabinet, f.sconce, f.boxes, f.plant, f.cabinet)
    chance = (0.15, 0.2, 0.2, 0.1, 0.15, 0.1, 0.1)
    maker = makers[rng.choice(len(makers), p=chance)]
    return replace(maker(rng), piece=maker.__name__.strip("_"))


def _scatter(placer: Furnisher) -> None:
    """Put things that stand about on the floor, anywhere."""
    makers = (f.boxes, f.chair, f.bin_, f.plant, f.office_chair, f.armchair)
    for _ in range(int(placer.rng.integers(0, 7))):
        maker = makers[int(placer.rng.integers(len(makers)))]
        x, y = placer.rng.uniform(0.3, 0.7, 2) * (placer.width, placer.depth)
        placer.near(maker, x, y, spread=1.0)


_SIZES_M: dict[str, tuple[tuple[float, float], tuple[float, float]]] = {
    "bathroom": ((2.2, 2.9), (2.4, 3.3)),
    "bedroom": ((3.2, 4.2), (3.4, 4.4)),
    "corridor": ((1.5, 2.1), (4.5, 8.0)),
    "kitchen": ((2.8, 4.0), (3.0, 4.4)),
    "living_room": ((3.6, 5.2), (4.0, 5.4)),
    "meeting_room": ((3.8, 5.0), (4.6, 6.2)),
    "office": ((3.2, 4.6), (3.6, 5.0)),
    "dining_room": ((3.2, 4.6), (3.6, 5.2)),
    "classroom": ((5.0, 7.5), (5.5, 8.5)),
}
_MAX_MESSY_CORRIDOR_GROWTH = 3.0
"""Corridors of public buildings are long."""
_BARE_CORRIDORS = 0.5
"""Share of messy corridors in which nothing stands."""
_FURNISH: dict[str, Callable[[Furnisher], None]] = {
    "bathroom": _bathroom,
    "bedroom": _bedroom,
    "corridor": _corridor,
    "kitchen": _kitchen,
    "living_room": _living_room,
    "meeting_room": _meeting_room,
    "office": _office,
    "dining_room": _dining_room,
    "classroom": _classroom,
}
_NUMBERS = {kind: number for number, kind in enumerate(_FURNISH)}
"""A room's random numbers depend on the number of its kind: new kinds come last."""

FIRST_KINDS = tuple(_FURNISH)[:7]
"""The kinds that the purely synthetic model knows."""
ROOM_KINDS = tuple(sorted(_FURNISH))
"""The kinds of rooms that can be made, which are the scene labels of the synthetic world."""
PIECES = (
    "", "bathtub", "toilet", "wash_basin", "washing_machine", "shower", "towel_rail", "bed", "sofa",
    "armchair", "tv_stand", "floor_lamp", "ceiling_lamp", "sconce", "plant", "boxes", "bin",
    "whiteboard", "picture", "radiator", "counter", "fridge", "stove", "bookshelf", "cabinet",
    "wardrobe", "nightstand", "shoe_rack", "coat_rack", "console", "wall_shelf", "wall_cabinet",
    "chair", "dining_set", "conference_set", "banquet_set", "desk_rows", "desk", "office_chair",
    "coffee_table",
)  # fmt: skip
"""Kinds of furniture. The first is what is none: walls, floor, ceiling, doors and windows."""


def make_room(
    kind: str,
    seed: int,
    *,
    size: tuple[float, float, float] | None = None,
    openings: list[Opening] | None = None,
    clear: Array | None = None,
    messy: bool = False,
) -> Room:
    """Build and furnish a room.

    Parameters
    ----------
    kind
        One of ``ROOM_KINDS``.
    seed
        The same seed and options give the same room.
    size
        Width, depth and height in metres; by default random, typical of the kind.
    openings
        Doors and windows; by default one or two doors and windows at random places.
    clear
        (K, 4) columns x, y, bottom, radius that furniture leaves free, from ``bottom`` up; by
        default none.
    messy
        Whether sizes vary more, walls hold less or more, and things stand about on the floor;
        corridors are up to three times as long, and half of them bare.

    Returns
    -------
    Room
        In its own frame: corner at the origin, x along its width, z up.

    Raises
    ------
    ValueError
        If the kind is unknown.
    """
    if kind not in _FURNISH:
        raise ValueError(f"kind must be one of {', '.join(ROOM_KINDS)}, got {kind!r}")
    rng = np.random.default_rng([seed, _NUMBERS[kind]])
    is_corridor = kind == "corridor"
    if size is None:
        (a, b), (c, d) = _SIZES_M[kind]
        size = (rng.uniform(a, b), rng.uniform(c, d), rng.uniform(2.4, 2.8))
        if messy:
            growth = rng.uniform(0.9, (1.5, _MAX_MESSY_CORRIDOR_GROWTH if is_corridor else 1.5))
            size = (size[0] * growth[0], size[1] * growth[1], rng.uniform(2.3, 3.4))
    width, depth, height = size
    if openings is None:
        openings = _random_openings(kind, width, depth, rng)
    if clear is None:
        clear = np.empty((0, 4))
    placer = Furnisher(width, depth, openings, clear, rng)
    if not (messy and is_corridor and rng.random() < _BARE_CORRIDORS):
        _FURNISH[kind](placer)
        density = rng.uniform(0.3, 2.2) if messy else 1.8
        placer.against_wall(_filler, n=round(density * (width + depth)))
        if messy:
            _scatter(placer)
    for _ in range(sum(opening.pane == "window" for opening in openings)):
        placer.against_wall(f.radiator)
    placer.hanging(f.ceiling_lamp, height)
    walls = shell(width, depth, height, openings, rng)
    parts = [walls, *placer.meshes]
    numbers = np.array([PIECES.index(part.piece) for part in parts], np.uint8)
    pieces = np.repeat(numbers, [len(part) for part in parts])
    return Room(kind, np.array(size), merge(parts), placer.boxes(), pieces)


def _random_openings(
    kind: str, width: float, depth: float, rng: np.random.Generator
) -> list[Opening]:
    """Choose a wall for each door and window, at most one to a wall (corridors: many doors)."""
    walls = rng.permutation(4)
    n_doors = 1 if rng.random() < 0.7 else 2
    openings = []
    for i, wall in enumerate(int(w) for w in walls):
        length = wall_length(wall, width, depth)
        if kind == "corridor":
            spots = np.arange(0.9, length - 0.8, 1.9) + rng.uniform(0.0, 0.3)
            for x in spots:
                if rng.random() < 0.65:
                    pane = "door" if rng.random() < 0.7 else "open"
                    openings.append(Opening(wall, float(x), DOOR_WIDTH_M, 0.0, DOOR_HEIGHT_M, pane))
        elif i < n_doors:
            x = rng.uniform(0.6, length - 0.6)
            pane = "door" if rng.random() < 0.6 else "open"
            openings.append(Opening(wall, x, DOOR_WIDTH_M, 0.0, DOOR_HEIGHT_M, pane))
        elif rng.random() < 0.5 and length > 2.0:
            w = rng.uniform(0.8, min(1.8, length - 0.9))
            x = rng.uniform(w / 2 + 0.2, length - w / 2 - 0.2)
            low = 0.85 if kind != "bathroom" else 1.3
            openings.append(Opening(wall, x, w, low, 2.15, "window"))
    return openings
