"""Shelves, cabinets and wardrobes."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.furniture.parts import (
    CLOTHS,
    PALES,
    STEEL,
    WHITE,
    WOODS,
    clutter,
    legs,
    pick,
    vivid,
)
from slam_bof.synthetic.meshes import Mesh, box, cylinder, ellipsoid, merge

__all__ = [
    "bookshelf",
    "cabinet",
    "coat_rack",
    "console",
    "nightstand",
    "shoe_rack",
    "wall_cabinet",
    "wall_shelf",
    "wardrobe",
]


def bookshelf(rng: np.random.Generator) -> Mesh:
    """Make an open shelf full of books and boxes."""
    w, d, h = rng.uniform(0.8, 1.2), rng.uniform(0.28, 0.36), rng.uniform(1.5, 2.1)
    color = pick(rng, WOODS + PALES)
    parts = [box(x, 0, 0, x + 0.025, d, h, color) for x in (-w / 2, w / 2 - 0.025)]
    parts.append(box(-w / 2, 0, 0, w / 2, 0.015, h, color))
    n_boards = int(rng.integers(4, 7))
    for i in range(n_boards + 1):
        z = 0.05 + i * (h - 0.08) / n_boards
        parts.append(box(-w / 2, 0, z, w / 2, d, z + 0.025, color))
        if i == n_boards:
            break
        room, x = (h - 0.08) / n_boards - 0.05, -w / 2 + 0.03
        while x < w / 2 - 0.12:
            if rng.random() < 0.75:
                t = rng.uniform(0.02, 0.07)
                tall, deep = rng.uniform(0.6, 0.98) * room, rng.uniform(0.6, 0.95) * d
                parts.append(box(x, 0.01, z + 0.025, x + t, deep, z + 0.025 + tall, vivid(rng)))
                x += t + 0.002
            else:
                x += rng.uniform(0.05, 0.3)
    return merge(parts)


def cabinet(rng: np.random.Generator) -> Mesh:
    """Make a filing cabinet or chest of drawers with things on it."""
    w, d, h = rng.uniform(0.5, 1.0), rng.uniform(0.4, 0.5), rng.uniform(0.7, 1.3)
    color = pick(rng, PALES + WOODS)
    n = max(2, round(h / 0.28))
    parts = [box(-w / 2, 0, 0, w / 2, d, h, color)]
    for i in range(n):
        z = 0.05 + i * (h - 0.07) / n
        parts.append(box(-w / 2 + 0.01, d, z, w / 2 - 0.01, d + 0.02, z + h / n - 0.05, color))
        parts.append(box(-0.08, d + 0.02, z + 0.1, 0.08, d + 0.045, z + 0.12, STEEL))
    parts.append(clutter(rng, -w / 2, 0, w / 2, d, h, int(rng.integers(2, 6))))
    return merge(parts)


def wardrobe(rng: np.random.Generator) -> Mesh:
    """Make a wardrobe with doors and boxes on top."""
    n, h, color = int(rng.integers(2, 4)), rng.uniform(1.9, 2.15), pick(rng, WOODS + PALES)
    w = 0.5 * n
    parts = [box(-w / 2, 0, 0, w / 2, 0.55, h, color)]
    for i in range(n):
        x, out = -w / 2 + 0.5 * i, rng.uniform(0.57, 0.6)
        parts.append(box(x + 0.01, 0.55, 0.06, x + 0.49, out, h - 0.04, color))
        parts.append(box(x + 0.42, out, 0.95, x + 0.45, out + 0.03, 1.2, STEEL))
    parts.append(clutter(rng, -w / 2, 0.05, w / 2, 0.5, h, 4))
    return merge(parts)


def nightstand(rng: np.random.Generator) -> Mesh:
    """Make a nightstand with a lamp."""
    h, color = rng.uniform(0.45, 0.6), pick(rng, WOODS)
    return merge(
        [
            box(-0.22, 0, 0.08, 0.22, 0.38, h, color),
            box(-0.2, 0.38, 0.12, 0.2, 0.4, h / 2, color),
            box(-0.2, 0.38, h / 2 + 0.02, 0.2, 0.4, h - 0.03, color),
            cylinder(0, 0.15, h, h + 0.2, 0.02, STEEL, sides=8),
            cylinder(0, 0.15, h + 0.18, h + 0.38, 0.13, WHITE, top_radius=0.08),
            clutter(rng, -0.2, 0.2, 0.2, 0.38, h, 2),
        ]
    )


def shoe_rack(rng: np.random.Generator) -> Mesh:
    """Make a shoe rack with shoes."""
    w, color = rng.uniform(0.7, 1.0), pick(rng, WOODS)
    parts = [box(x, 0, 0, x + 0.02, 0.3, 0.55, color) for x in (-w / 2, w / 2 - 0.02)]
    for z in (0.08, 0.3, 0.52):
        parts.append(box(-w / 2, 0, z, w / 2, 0.3, z + 0.02, color))
        for x in np.arange(-w / 2 + 0.08, w / 2 - 0.08, 0.14):
            if rng.random() < 0.7:
                parts.append(
                    ellipsoid((float(x), 0.16, z + 0.06), (0.05, 0.14, 0.06), pick(rng, CLOTHS))
                )
    return merge(parts)


def coat_rack(rng: np.random.Generator) -> Mesh:
    """Make a board of hooks with coats hanging on it."""
    w = rng.uniform(0.8, 1.2)
    parts = [box(-w / 2, 0, 1.65, w / 2, 0.03, 1.78, pick(rng, WOODS))]
    parts.append(box(-w / 2, 0, 1.9, w / 2, 0.25, 1.92, pick(rng, WOODS)))
    for x in np.arange(-w / 2 + 0.12, w / 2 - 0.05, 0.22):
        parts.append(box(x - 0.01, 0.03, 1.68, x + 0.01, 0.1, 1.7, STEEL))
        if rng.random() < 0.7:
            low, deep = rng.uniform(0.7, 1.1), rng.uniform(0.12, 0.22)
            color = pick(rng, CLOTHS)
            parts.append(box(x - 0.09, 0.03, low, x + 0.09, deep, 1.45, color))
            parts.append(ellipsoid((float(x), deep / 2 + 0.02, 1.5), (0.11, 0.1, 0.16), color))
    return merge(parts)


def console(rng: np.random.Generator) -> Mesh:
    """Make a narrow console table with things on it."""
    w, h, color = rng.uniform(0.7, 1.1), rng.uniform(0.75, 0.9), pick(rng, WOODS)
    parts = [
        box(-w / 2, 0, h - 0.12, w / 2, 0.3, h, color),
        *legs(w / 2 - 0.04, 0.11, h - 0.1, color, cx=0, cy=0.15),
        clutter(rng, -w / 2, 0, w / 2, 0.3, h, 4),
    ]
    return merge(parts)


def wall_shelf(rng: np.random.Generator) -> Mesh:
    """Make a shelf on the wall, with books."""
    w, z = rng.uniform(0.35, 0.6), rng.uniform(1.45, 1.7)
    parts = [box(-w, 0, z, w, 0.24, z + 0.03, pick(rng, WOODS))]
    for x in np.arange(-w + 0.03, w - 0.05, 0.05):
        if rng.random() < 0.7:
            h = rng.uniform(0.15, 0.28)
            parts.append(
                box(x, 0.01, z + 0.03, x + 0.045, rng.uniform(0.12, 0.22), z + 0.03 + h, vivid(rng))
            )
    return merge(parts)


def wall_cabinet(rng: np.random.Generator) -> Mesh:
    """Make a cabinet that hangs on the wall, with things on it."""
    w, d, h = rng.uniform(0.2, 0.45), rng.uniform(0.16, 0.34), rng.uniform(0.3, 0.7)
    z, color = rng.uniform(1.15, 1.45), pick(rng, WOODS + PALES)
    return merge(
        [
            box(-w, 0, z, w, d, z + h, color),
            box(-w + 0.02, d, z + 0.03, w - 0.02, d + 0.02, z + h - 0.03, color),
            box(w - 0.1, d + 0.02, z + 0.06, w - 0.07, d + 0.05, z + 0.2, STEEL),
            clutter(rng, -w, 0, w, d, z + h, int(rng.integers(1, 4))),
        ]
    )
