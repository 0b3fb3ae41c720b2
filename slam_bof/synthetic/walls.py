"""The shell of a room: floor, ceiling, walls with doors and windows.

A room stands on z = 0 with its inner corner at the origin, width along x and depth along y.
Its walls are numbered 0 south (y = 0), 1 east, 2 north, 3 west. In a wall's own frame x runs
along the wall, y into the room and z up, like the frame of a piece of furniture.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from slam_bof.synthetic.furniture.parts import DARK, PALES, STEEL, WHITE, WOODS, pick
from slam_bof.synthetic.meshes import Color, Mesh, box, merge

__all__ = ["WALL_THICKNESS_M", "Opening", "on_wall", "shell", "wall_length"]

WALL_THICKNESS_M = 0.1


@dataclass(frozen=True, slots=True)
class Opening:
    """An opening in a wall, with its centre at ``x`` along the wall.

    ``pane`` is ``open`` (a passage), ``door`` (a closed leaf) or ``window`` (a blind behind
    the recess).
    """

    wall: int
    x: float
    width: float
    bottom: float
    top: float
    pane: str


def wall_length(wall: int, width: float, depth: float) -> float:
    """Return the length of a wall of a room of this size."""
    return width if wall % 2 == 0 else depth


def on_wall(mesh: Mesh, wall: int, x: float, width: float, depth: float) -> Mesh:
    """Move a piece from the frame of a wall to ``x`` along that wall of the room."""
    along = mesh.placed(x, 0.0)
    corner = ((0.0, 0.0), (width, 0.0), (width, depth), (0.0, depth))[wall]
    return along.placed(*corner, yaw=wall * np.pi / 2)


def _frame(opening: Opening, color: Color) -> Mesh:
    a, b = opening.x - opening.width / 2, opening.x + opening.width / 2
    low, top, t = opening.bottom, opening.top, 0.07
    inside = 0.012  # in front of the wall, so that no two surfaces coincide
    back = -WALL_THICKNESS_M
    return merge(
        [
            box(a - t, back, low, a + inside, 0.02, top + t, color),
            box(b - inside, back, low, b + t, 0.02, top + t, color),
            box(a - t, back, top - inside, b + t, 0.02, top + t, color),
        ]
    )


def _pane(opening: Opening, rng: np.random.Generator) -> Mesh:
    a, b = opening.x - opening.width / 2, opening.x + opening.width / 2
    low, top = opening.bottom, opening.top
    if opening.pane == "door":
        return merge(
            [
                box(a, -0.09, low, b, -0.03, top, pick(rng, WOODS + PALES)),
                box(b - 0.14, -0.03, 1.0, b - 0.04, 0.03, 1.04, STEEL),
                box(a + 0.12, -0.03, 0.2, b - 0.12, -0.02, 0.9, pick(rng, PALES)),
            ]
        )
    if opening.pane == "window":
        middle = (a + b) / 2
        slats = [
            box(a, -0.09, z, b, -0.07 - 0.01 * (i % 2), z + 0.06, (0.6, 0.7, 0.8))
            for i, z in enumerate(np.arange(low, top - 0.03, 0.06))
        ]
        return merge(
            [
                *slats,
                box(middle - 0.03, -0.09, low, middle + 0.03, -0.03, top, WHITE),
                box(a - 0.08, -0.09, low - 0.03, b + 0.08, 0.12, low, WHITE),
            ]
        )
    return Mesh()


def shell(
    width: float, depth: float, height: float, openings: list[Opening], rng: np.random.Generator
) -> Mesh:
    """Build floor, ceiling, walls, skirting boards, doors and windows.

    Parameters
    ----------
    width, depth, height
        Inner size in metres, along x, y and z.
    openings
        Doors and windows; those of one wall must not overlap.
    rng
        Chooses colours.
    """
    paint, boards = pick(rng, PALES), pick(rng, (*WOODS, (0.5, 0.5, 0.5)))
    t = WALL_THICKNESS_M
    parts = [
        box(-t, -t, -0.05, width + t, depth + t, 0.0, boards),
        box(-t, -t, height, width + t, depth + t, height + 0.05, WHITE),
    ]
    for wall in range(4):
        length = wall_length(wall, width, depth)
        holes = sorted((o for o in openings if o.wall == wall), key=lambda o: o.x)
        pieces, start = [], -t
        for hole in holes:
            a, b = hole.x - hole.width / 2, hole.x + hole.width / 2
            pieces += [_panel(start, a, height, paint), box(a, -t, hole.top, b, 0, height, paint)]
            if hole.bottom > 0:
                pieces.append(box(a, -t, 0, b, 0, hole.bottom, paint))
            pieces += [_frame(hole, DARK if hole.pane == "door" else WHITE), _pane(hole, rng)]
            start = b
        pieces.append(_panel(start, length + t, height, paint))
        parts.append(on_wall(merge(pieces), wall, 0.0, width, depth))
    return merge(parts)


def _panel(a: float, b: float, height: float, color: Color) -> Mesh:
    wall = box(a, -WALL_THICKNESS_M, 0.0, b, 0.0, height, color)
    return merge([wall, box(a, 0.0, 0.0, b, 0.015, 0.08, WHITE)])
