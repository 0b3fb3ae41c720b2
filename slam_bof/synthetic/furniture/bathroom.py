"""Bathroom furniture."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.furniture.parts import (
    CLOTHS,
    DARK,
    PALES,
    STEEL,
    WHITE,
    WOODS,
    clutter,
    curtain,
    pick,
    vivid,
)
from slam_bof.synthetic.meshes import Mesh, box, cylinder, ellipsoid, merge

__all__ = ["bathtub", "shower", "toilet", "towel_rail", "wash_basin", "washing_machine"]


def bathtub(rng: np.random.Generator) -> Mesh:
    """Make a bath tub along the wall, with tap and a ledge above."""
    w, d, h = rng.uniform(1.5, 1.7), 0.72, rng.uniform(0.52, 0.6)
    return merge(
        [
            box(-w / 2, 0, 0, w / 2, 0.08, h, WHITE),
            box(-w / 2, d - 0.08, 0, w / 2, d, h, WHITE),
            box(-w / 2, 0, 0, -w / 2 + 0.1, d, h, WHITE),
            box(w / 2 - 0.1, 0, 0, w / 2, d, h, WHITE),
            box(-w / 2, 0, 0, w / 2, d, 0.15, WHITE),
            box(-w / 2 + 0.02, 0.3, h, -w / 2 + 0.14, 0.42, h + 0.2, STEEL),
            box(-0.3, 0.0, 0.95, 0.3, 0.14, 0.98, STEEL),
            clutter(rng, -0.3, 0.0, 0.3, 0.14, 0.98, 3),
            clutter(rng, 0, 0, w / 2, 0.12, h, 2),
        ]
    )


def toilet(rng: np.random.Generator) -> Mesh:
    """Make a toilet with cistern, bowl and lid."""
    h = rng.uniform(0.38, 0.44)
    return merge(
        [
            box(-0.2, 0, h - 0.04, 0.2, 0.18, h + 0.38, WHITE),
            box(-0.03, 0.06, h + 0.38, 0.03, 0.12, h + 0.4, STEEL),
            cylinder(0, 0.45, 0, h, 0.11, WHITE, top_radius=0.2),
            cylinder(0, 0.45, h, h + 0.04, 0.22, WHITE),
            box(-0.19, 0.17, h - 0.06, 0.19, 0.42, h + 0.03, WHITE),
            cylinder(0.4, 0.12, 0, rng.uniform(0.3, 0.45), 0.06, STEEL, sides=10),
            box(0.32, 0.0, 0.65, 0.46, 0.12, 0.77, WHITE),
        ]
    )


def wash_basin(rng: np.random.Generator) -> Mesh:
    """Make a wash basin on a cabinet, with tap and a mirror cabinet above."""
    w, top = rng.uniform(0.55, 0.9), rng.uniform(0.82, 0.88)
    wood = pick(rng, WOODS + PALES)
    return merge(
        [
            box(-w / 2 + 0.04, 0, 0.25, w / 2 - 0.04, 0.4, top - 0.12, wood),
            box(-w / 2, 0, top - 0.12, w / 2, 0.06, top, WHITE),
            box(-w / 2, 0.42, top - 0.12, w / 2, 0.48, top, WHITE),
            box(-w / 2, 0, top - 0.12, -w / 2 + 0.05, 0.48, top, WHITE),
            box(w / 2 - 0.05, 0, top - 0.12, w / 2, 0.48, top, WHITE),
            box(-w / 2, 0, top - 0.14, w / 2, 0.48, top - 0.09, WHITE),
            cylinder(0, 0.07, top, top + 0.15, 0.02, STEEL, sides=8),
            box(-0.02, 0.07, top + 0.13, 0.02, 0.2, top + 0.16, STEEL),
            box(-w / 2, 0, top + 0.35, w / 2, 0.14, top + 1.0, STEEL),
            box(-w / 2 + 0.02, 0, top + 0.22, w / 2 - 0.02, 0.13, top + 0.24, wood),
            clutter(rng, -w / 2, 0, w / 2, 0.13, top + 0.24, 4),
        ]
    )


def washing_machine(rng: np.random.Generator) -> Mesh:
    """Make a washing machine with a laundry basket on it."""
    rings = [
        box(-0.3, 0, 0, 0.3, 0.58, 0.85, WHITE),
        box(-0.2, 0.58, 0.22, 0.2, 0.61, 0.62, STEEL),
        box(-0.13, 0.61, 0.29, 0.13, 0.63, 0.55, DARK),
        box(-0.28, 0.58, 0.72, 0.28, 0.6, 0.82, STEEL),
    ]
    basket = cylinder(
        0, 0.3, 0.85, 0.85 + rng.uniform(0.2, 0.35), 0.18, vivid(rng), top_radius=0.25
    )
    cloth = ellipsoid((0, 0.3, 1.12), (0.2, 0.2, 0.12), pick(rng, CLOTHS))
    return merge([*rings, basket, cloth])


def shower(rng: np.random.Generator) -> Mesh:
    """Make a shower: tray, one screen, rail, head."""
    w = rng.uniform(0.8, 0.95)
    return merge(
        [
            box(-w / 2, 0, 0, w / 2, w, 0.1, WHITE),
            box(-w / 2, 0, 0.1, -w / 2 + 0.03, w, 2.0, STEEL),
            curtain(rng, -w / 2, w / 2 - 0.35, w - 0.06, 0.15, 1.95),
            cylinder(0, 0.05, 0.8, 2.05, 0.015, STEEL, sides=8),
            cylinder(0, 0.18, 1.98, 2.02, 0.1, STEEL, sides=12),
            clutter(rng, 0.1, 0.02, w / 2, 0.2, 0.1, 3),
        ]
    )


def towel_rail(rng: np.random.Generator) -> Mesh:
    """Make a radiator of rungs with a towel over it."""
    h, cloth = rng.uniform(1.2, 1.7), pick(rng, CLOTHS)
    parts = [box(x - 0.015, 0.04, 0.2, x + 0.015, 0.07, h, WHITE) for x in (-0.25, 0.25)]
    parts += [box(-0.25, 0.05, z, 0.25, 0.08, z + 0.03, WHITE) for z in np.arange(0.25, h, 0.09)]
    z = rng.uniform(0.6, h - 0.3)
    parts.append(box(-0.2, 0.08, z - 0.3, 0.15, 0.12, z + 0.3, cloth))
    return merge(parts)
