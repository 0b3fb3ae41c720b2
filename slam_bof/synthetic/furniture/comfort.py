"""Beds, sofas, televisions."""

from __future__ import annotations

import numpy as np

from slam_bof.synthetic.furniture.parts import (
    CLOTHS,
    DARK,
    PALES,
    WHITE,
    WOODS,
    clutter,
    legs,
    pick,
    vivid,
)
from slam_bof.synthetic.meshes import Mesh, box, ellipsoid, merge

__all__ = ["armchair", "bed", "sofa", "tv_stand"]


def bed(rng: np.random.Generator) -> Mesh:
    """Make a bed with headboard, mattress, blanket and pillows; its head is at the wall."""
    w, cloth, wood = rng.uniform(0.95, 1.6), pick(rng, CLOTHS), pick(rng, WOODS)
    n_pillows = 1 if w < 1.25 else 2
    parts = [
        box(-w / 2 - 0.03, 0, 0, w / 2 + 0.03, 0.05, rng.uniform(0.85, 1.15), wood),
        box(-w / 2 - 0.03, 0, 0.12, w / 2 + 0.03, 2.05, 0.3, wood),
        box(-w / 2, 0.05, 0.3, w / 2, 2.0, 0.48, WHITE),
        box(-w / 2 - 0.02, 0.7, 0.35, w / 2 + 0.02, 2.03, 0.55, cloth),
        box(-w / 2 - 0.02, 0.7, 0.55, w / 2 + 0.02, 0.95, 0.6, WHITE),
    ]
    parts += legs(w / 2, 0.95, 0.12, wood, cx=0, cy=1.02)
    for i in range(n_pillows):
        x = (i - (n_pillows - 1) / 2) * w / 2
        parts.append(ellipsoid((x, 0.33, 0.52), (0.3, 0.22, 0.09), WHITE))
    parts.append(ellipsoid((0.1 * w, 1.5, 0.55), (0.3, 0.25, rng.uniform(0.05, 0.16)), cloth))
    return merge(parts)


def sofa(rng: np.random.Generator) -> Mesh:
    """Make a sofa with arms, seat cushions and pillows."""
    n, cloth = int(rng.integers(2, 4)), pick(rng, CLOTHS)
    w, d = 0.62 * n + 0.4, rng.uniform(0.8, 0.95)
    seat, back = rng.uniform(0.38, 0.44), rng.uniform(0.75, 0.9)
    parts = [
        box(-w / 2, 0, 0.06, w / 2, 0.2, back, cloth),
        box(-w / 2, 0, 0.06, w / 2, d - 0.02, seat - 0.14, cloth),
    ]
    for x in (-w / 2, w / 2 - 0.2):
        parts.append(box(x, 0, 0.06, x + 0.2, d, seat + 0.2, cloth))
    for i in range(n):
        x = -w / 2 + 0.2 + 0.62 * i
        parts.append(box(x + 0.01, 0.18, seat - 0.14, x + 0.61, d + 0.02, seat, cloth))
        parts.append(ellipsoid((x + 0.31, 0.27, back - 0.1), (0.28, 0.1, 0.25), cloth))
    x = rng.uniform(-w / 4, w / 4)
    parts.append(ellipsoid((x, 0.4, seat + 0.17), (0.22, 0.11, 0.2), vivid(rng)))
    return merge(parts)


def armchair(rng: np.random.Generator) -> Mesh:
    """Make an armchair."""
    cloth, seat = pick(rng, CLOTHS), rng.uniform(0.38, 0.44)
    return merge(
        [
            box(-0.4, 0, 0.1, 0.4, 0.2, 0.9, cloth),
            box(-0.4, 0, 0.1, -0.24, 0.8, 0.62, cloth),
            box(0.24, 0, 0.1, 0.4, 0.8, 0.62, cloth),
            box(-0.24, 0.1, 0.1, 0.24, 0.8, seat, cloth),
            ellipsoid((0, 0.28, 0.62), (0.2, 0.1, 0.18), vivid(rng)),
            *legs(0.33, 0.33, 0.1, DARK, cx=0, cy=0.4),
        ]
    )


def tv_stand(rng: np.random.Generator) -> Mesh:
    """Make a low board with a television and speakers."""
    w, color, wide = rng.uniform(1.3, 1.8), pick(rng, WOODS + PALES), rng.uniform(0.45, 0.6)
    parts = [
        box(-w / 2, 0, 0.08, w / 2, 0.4, 0.45, color),
        box(-w / 2 + 0.05, 0.4, 0.12, -0.03, 0.42, 0.42, color),
        box(0.03, 0.4, 0.12, w / 2 - 0.05, 0.42, 0.42, color),
        box(-wide, 0.15, 0.53, wide, 0.2, 0.53 + 1.13 * wide, DARK),
        box(-0.25, 0.08, 0.45, 0.25, 0.3, 0.47, DARK),
        box(-0.05, 0.12, 0.45, 0.05, 0.16, 0.6, DARK),
        box(-w / 2 - 0.25, 0.03, 0, -w / 2 - 0.05, 0.3, rng.uniform(0.5, 1.0), DARK),
    ]
    parts.append(clutter(rng, -w / 2, 0.2, w / 2, 0.4, 0.45, 4))
    return merge(parts)
