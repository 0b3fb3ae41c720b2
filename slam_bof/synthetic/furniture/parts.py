"""Colours, legs, curtains and small things that pieces of furniture are made of."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.meshes import Color, Mesh, box, cylinder, merge

__all__ = [
    "CLOTHS",
    "DARK",
    "GREEN",
    "PALES",
    "STEEL",
    "WHITE",
    "WOODS",
    "clutter",
    "curtain",
    "legs",
    "pick",
    "vivid",
]

WOODS: tuple[Color, ...] = ((0.55, 0.38, 0.22), (0.72, 0.56, 0.36), (0.36, 0.24, 0.16))
PALES: tuple[Color, ...] = ((0.9, 0.9, 0.88), (0.82, 0.8, 0.74), (0.66, 0.7, 0.74))
CLOTHS: tuple[Color, ...] = (
    (0.3, 0.4, 0.6),
    (0.6, 0.28, 0.25),
    (0.36, 0.5, 0.36),
    (0.5, 0.5, 0.55),
)
DARK: Color = (0.12, 0.12, 0.13)
STEEL: Color = (0.62, 0.64, 0.66)
WHITE: Color = (0.93, 0.93, 0.93)
GREEN: Color = (0.2, 0.45, 0.2)


def pick(rng: np.random.Generator, colors: tuple[Color, ...]) -> Color:
    """Choose a colour and vary it a little."""
    color = np.asarray(colors[rng.integers(len(colors))]) + rng.uniform(-0.05, 0.05, 3)
    red, green, blue = np.clip(color, 0.02, 0.98)
    return float(red), float(green), float(blue)


def vivid(rng: np.random.Generator) -> Color:
    """Choose any colour."""
    red, green, blue = rng.uniform(0.1, 0.9, 3)
    return float(red), float(green), float(blue)


def legs(x: float, y: float, z: float, color: Color, *, cx: float, cy: float) -> list[Mesh]:
    """Make four legs of height ``z``, ``x`` and ``y`` to each side of their centre."""
    r = 0.025
    return [
        box(cx + sx * x - r, cy + sy * y - r, 0, cx + sx * x + r, cy + sy * y + r, z, color)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


def curtain(rng: np.random.Generator, x0: float, x1: float, y: float, z0: float, z1: float) -> Mesh:
    """Make a curtain in folds between x0 and x1."""
    color, n = pick(rng, CLOTHS), max(2, int((x1 - x0) / 0.1))
    xs = np.linspace(x0, x1, n + 1)
    return merge(
        [
            box(xs[i], y - 0.015 + 0.045 * (i % 2), z0, xs[i + 1], y + 0.045 * (i % 2), z1, color)
            for i in range(n)
        ]
    )


def clutter(
    rng: np.random.Generator, x0: float, y0: float, x1: float, y1: float, z: float, n: int
) -> Mesh:
    """Put ``n`` small things (boxes, cups, bottles, books) on a surface of height ``z``."""
    things = []
    for _ in range(n):
        thing = _small_thing(rng).placed(0.0, 0.0, yaw=rng.uniform(0.0, np.pi))
        low, high = thing.bounds()
        # Nothing juts over the edge: it would stand in the wall, or block the room.
        shrink = min(1.0, 0.98 * (x1 - x0) / (high - low)[0], 0.98 * (y1 - y0) / (high - low)[1])
        thing = Mesh(thing.triangles * (shrink, shrink, 1.0), thing.albedo)
        x = rng.uniform(x0 - shrink * low[0], x1 - shrink * high[0])
        y = rng.uniform(y0 - shrink * low[1], y1 - shrink * high[1])
        things.append(thing.placed(x, y, z))
    return merge(things)


def _small_thing(rng: np.random.Generator) -> Mesh:
    kind = rng.integers(4)
    if kind == 0:  # a box
        w, d, h = rng.uniform(0.04, 0.14, 3)
        return box(-w, -d, 0, w, d, 2 * h, vivid(rng))
    if kind == 1:  # a cup
        return cylinder(0, 0, 0, rng.uniform(0.08, 0.13), 0.045, vivid(rng), sides=10)
    if kind == 2:  # a bottle
        h = rng.uniform(0.2, 0.32)
        neck = cylinder(0, 0, 0.7 * h, h, 0.04, DARK, top_radius=0.013, sides=10)
        return merge([cylinder(0, 0, 0, 0.7 * h, 0.04, vivid(rng), sides=10), neck])
    return box(-0.1, -0.14, 0, 0.1, 0.14, rng.uniform(0.02, 0.1), vivid(rng))  # books
