"""Lamps, plants, boxes, pictures, boards, radiators."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.furniture.parts import (
    DARK,
    GREEN,
    STEEL,
    WHITE,
    WOODS,
    clutter,
    pick,
    vivid,
)
from slam_bof.synthetic.meshes import Mesh, box, cylinder, ellipsoid, merge

__all__ = [
    "bin_",
    "boxes",
    "ceiling_lamp",
    "floor_lamp",
    "picture",
    "plant",
    "radiator",
    "sconce",
    "whiteboard",
]


def floor_lamp(rng: np.random.Generator) -> Mesh:
    """Make a floor lamp."""
    h = rng.uniform(1.4, 1.7)
    return merge(
        [
            cylinder(0, 0.2, 0, 0.03, 0.16, STEEL),
            cylinder(0, 0.2, 0.03, h, 0.015, STEEL, sides=8),
            cylinder(0, 0.2, h - 0.05, h + 0.25, 0.2, WHITE, top_radius=0.12),
        ]
    )


def ceiling_lamp(rng: np.random.Generator) -> Mesh:
    """Make a lamp that hangs from z = 0 (the ceiling) downwards."""
    drop, r = rng.uniform(0.25, 0.6), rng.uniform(0.15, 0.28)
    return merge(
        [
            cylinder(0, 0, -drop, 0, 0.01, DARK, sides=6),
            cylinder(0, 0, -drop - 0.2, -drop, r, WHITE, top_radius=r / 3),
        ]
    )


def sconce(rng: np.random.Generator) -> Mesh:
    """Make a lamp on the wall."""
    z, r = rng.uniform(1.5, 1.8), rng.uniform(0.08, 0.13)
    return merge(
        [
            box(-0.05, 0, z, 0.05, 0.05, z + 0.12, STEEL),
            box(-0.015, 0.05, z + 0.04, 0.015, 0.16, z + 0.07, STEEL),
            cylinder(0, 0.05 + r, z + 0.05, z + 0.25, r / 2, WHITE, top_radius=r),
        ]
    )


def plant(rng: np.random.Generator) -> Mesh:
    """Make a plant in a pot."""
    h = rng.uniform(0.7, 1.5)
    parts = [
        cylinder(0, 0.25, 0, 0.3, 0.12, pick(rng, WOODS), top_radius=0.17),
        cylinder(0, 0.25, 0.3, h, 0.02, pick(rng, WOODS), sides=8),
    ]
    for _ in range(int(rng.integers(6, 12))):
        a, r = rng.uniform(0, 2 * np.pi), rng.uniform(0.05, 0.2)
        size = rng.uniform(0.06, 0.16, 3)
        z = rng.uniform(0.5, 1.0) * h
        center = (float(r * np.cos(a)), float(0.25 + r * np.sin(a)), float(z))
        parts.append(ellipsoid(center, (size[0], size[1], size[2]), pick(rng, (GREEN,))))
    return merge(parts)


def boxes(rng: np.random.Generator) -> Mesh:
    """Make a stack of cardboard boxes."""
    parts, z = [], 0.0
    for _ in range(int(rng.integers(1, 4))):
        w, d, h = rng.uniform(0.15, 0.28), rng.uniform(0.15, 0.24), rng.uniform(0.2, 0.42)
        color = pick(rng, ((0.65, 0.5, 0.33),))
        turned = box(-w, -d, 0, w, d, h, color).placed(0, 0.28, z, yaw=rng.uniform(-0.2, 0.2))
        parts.append(turned)
        z += h
    return merge(parts)


def bin_(rng: np.random.Generator) -> Mesh:
    """Make a waste bin."""
    return cylinder(
        0, 0.18, 0, rng.uniform(0.3, 0.5), 0.12, vivid(rng), top_radius=rng.uniform(0.13, 0.17)
    )


def whiteboard(rng: np.random.Generator) -> Mesh:
    """Make a board on the wall with a tray."""
    w = rng.uniform(0.6, 1.1)
    return merge(
        [
            box(-w, 0, 0.95, w, 0.03, 2.0, STEEL),
            box(-w + 0.03, 0.03, 0.98, w - 0.03, 0.035, 1.97, WHITE),
            box(-w * 0.6, 0.03, 0.93, w * 0.6, 0.11, 0.96, STEEL),
            clutter(rng, -w * 0.6, 0.0, w * 0.6, 0.13, 0.96, 2),
        ]
    )


def picture(rng: np.random.Generator) -> Mesh:
    """Make a framed picture on the wall."""
    w, h = rng.uniform(0.15, 0.45), rng.uniform(0.2, 0.35)
    z = rng.uniform(1.4, 1.6)
    return merge(
        [
            box(-w, 0, z - h, w, 0.03, z + h, pick(rng, WOODS)),
            box(-w + 0.04, 0.03, z - h + 0.04, w - 0.04, 0.034, z + h - 0.04, vivid(rng)),
        ]
    )


def radiator(rng: np.random.Generator) -> Mesh:
    """Make a ribbed radiator for under a window."""
    w = rng.uniform(0.4, 0.7)
    parts = [box(-w, 0.03, 0.12, w, 0.08, 0.68, WHITE)]
    parts += [
        box(x, 0.08, 0.14, x + 0.04, 0.11, 0.66, WHITE) for x in np.arange(-w, w - 0.03, 0.08)
    ]
    return merge(parts)
