"""Kitchen furniture."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.furniture.parts import DARK, PALES, STEEL, WHITE, WOODS, clutter, pick
from slam_bof.synthetic.meshes import Mesh, box, cylinder, merge

__all__ = ["counter", "fridge", "stove"]


def counter(rng: np.random.Generator) -> Mesh:
    """Make a kitchen counter with sink or hob, doors, and cupboards on the wall above."""
    n = int(rng.integers(3, 5))
    w, top = 0.6 * n, rng.uniform(0.88, 0.94)
    front, plate = pick(rng, PALES), pick(rng, WOODS)
    x0 = -w / 2
    parts = [
        box(x0, 0, 0.1, -x0, 0.56, top - 0.04, front),
        box(x0, 0, 0, -x0, 0.5, 0.1, DARK),
        box(x0, 0, top - 0.04, -x0, 0.62, top, plate),
    ]
    for i in range(n):
        a = x0 + 0.6 * i
        parts += [
            box(a + 0.01, 0.56, 0.13, a + 0.59, 0.58, top - 0.06, front),
            box(a + 0.2, 0.58, top - 0.13, a + 0.4, 0.6, top - 0.11, STEEL),
        ]
    sink = x0 + 0.6 * rng.integers(n)
    parts += [
        box(sink + 0.08, 0.1, top, sink + 0.52, 0.5, top + 0.015, STEEL),
        cylinder(sink + 0.3, 0.08, top, top + 0.28, 0.02, STEEL, sides=8),
        box(sink + 0.28, 0.08, top + 0.26, sink + 0.32, 0.26, top + 0.29, STEEL),
    ]
    low = rng.uniform(1.42, 1.5)
    for i in range(n):
        if rng.random() < 0.25:  # an open shelf instead of a cupboard
            a = x0 + 0.6 * i
            parts.append(box(a, 0, low + 0.2, a + 0.6, 0.28, low + 0.23, plate))
            parts.append(clutter(rng, a, 0, a + 0.6, 0.28, low + 0.23, 4))
            continue
        a, d = x0 + 0.6 * i, rng.uniform(0.32, 0.37)
        parts.append(box(a + 0.005, 0, low, a + 0.595, d, low + 0.7, front))
        parts.append(box(a + 0.5, d, low + 0.05, a + 0.52, d + 0.02, low + 0.25, STEEL))
    parts.append(clutter(rng, x0, 0.1, -x0, 0.55, top, int(rng.integers(4, 9))))
    return merge(parts)


def fridge(rng: np.random.Generator) -> Mesh:
    """Make a fridge with two doors and handles."""
    h, color = rng.uniform(1.5, 2.0), pick(rng, PALES)
    return merge(
        [
            box(-0.3, 0.02, 0, 0.3, 0.58, h, color),
            box(-0.3, 0.585, 0.05, 0.3, 0.64, h * 0.35, color),
            box(-0.3, 0.585, h * 0.36, 0.3, 0.64, h, color),
            box(0.22, 0.64, h * 0.4, 0.25, 0.68, h * 0.65, STEEL),
            clutter(rng, -0.3, 0.1, 0.3, 0.5, h, 3),
        ]
    )


def stove(rng: np.random.Generator) -> Mesh:
    """Make a stove with pots and an extractor hood above."""
    parts = [
        box(-0.3, 0, 0, 0.3, 0.6, 0.9, WHITE),
        box(-0.26, 0.6, 0.2, 0.26, 0.62, 0.65, DARK),
        box(-0.24, 0.62, 0.66, 0.24, 0.65, 0.69, STEEL),
        box(-0.3, 0, 1.55, 0.3, 0.48, 1.65, STEEL),
        box(-0.13, 0, 1.65, 0.13, 0.28, 2.3, STEEL),
    ]
    for x, y in ((-0.15, 0.18), (0.15, 0.42), (0.15, 0.18)):
        if rng.random() < 0.7:
            parts.append(cylinder(x, y, 0.9, 0.9 + rng.uniform(0.06, 0.22), 0.1, STEEL))
    return merge(parts)
