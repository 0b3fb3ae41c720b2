"""Tables, desks, chairs and what stands on them."""

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
    legs,
    pick,
)
from slam_bof.synthetic.meshes import Mesh, box, cylinder, merge

__all__ = [
    "banquet_set",
    "chair",
    "coffee_table",
    "conference_set",
    "desk",
    "desk_rows",
    "dining_set",
    "office_chair",
]


def chair(rng: np.random.Generator) -> Mesh:
    """Make a chair; it faces +y."""
    color, seat = pick(rng, WOODS), rng.uniform(0.43, 0.47)
    parts = legs(0.18, 0.18, seat, color, cx=0, cy=0.22)
    parts.append(box(-0.21, 0.0, seat, 0.21, 0.43, seat + 0.04, color))
    parts += [box(x - 0.02, 0, seat, x + 0.02, 0.035, 0.9, color) for x in (-0.19, 0.19)]
    parts.append(box(-0.21, 0, 0.62, 0.21, 0.03, 0.92, color))
    return merge(parts)


def _table_set(rng: np.random.Generator, w: float, d: float, n_side: int, ends: bool) -> Mesh:
    h, color = rng.uniform(0.72, 0.76), pick(rng, WOODS)
    gap, cy = 0.5, 0.5 + d / 2
    parts = [box(-w / 2, cy - d / 2, h - 0.035, w / 2, cy + d / 2, h, color)]
    parts += legs(w / 2 - 0.06, d / 2 - 0.06, h - 0.03, color, cx=0, cy=cy)
    parts.append(clutter(rng, -w / 2, cy - d / 2, w / 2, cy + d / 2, h, int(3 + 4 * w)))
    seats = rng.integers(0, 2**31)
    for i in range(n_side):
        x = (i + 0.5) / n_side * w - w / 2
        for y, yaw in ((cy - d / 2 - gap + 0.18, 0.0), (cy + d / 2 + gap - 0.18, np.pi)):
            if rng.random() < 0.85:
                one = chair(np.random.default_rng(seats))
                parts.append(one.placed(x, y, yaw=yaw + rng.uniform(-0.3, 0.3)))
    if ends:
        one = chair(np.random.default_rng(seats))
        parts.append(one.placed(-w / 2 - 0.35, cy, yaw=-np.pi / 2 + rng.uniform(-0.2, 0.2)))
        parts.append(one.placed(w / 2 + 0.35, cy, yaw=np.pi / 2 + rng.uniform(-0.2, 0.2)))
    return merge(parts)


def dining_set(rng: np.random.Generator) -> Mesh:
    """Make a dining table with chairs around it."""
    return _table_set(rng, rng.uniform(0.8, 1.3), rng.uniform(0.7, 0.85), 2, False)


def conference_set(rng: np.random.Generator) -> Mesh:
    """Make a long meeting table with many chairs."""
    n = int(rng.integers(3, 5))
    return _table_set(rng, 0.62 * n, rng.uniform(0.95, 1.2), n, True)


def banquet_set(rng: np.random.Generator) -> Mesh:
    """Make the large table of a dining room with its chairs."""
    n = int(rng.integers(2, 4))
    ends = bool(rng.random() < 0.7)
    return _table_set(rng, rng.uniform(0.6, 0.75) * n, rng.uniform(0.85, 1.1), n, ends)


def desk_rows(rng: np.random.Generator) -> Mesh:
    """Make the rows of tables and chairs of a classroom; all face -y."""
    n_rows, n_columns = int(rng.integers(2, 5)), int(rng.integers(2, 4))
    w, h, color = rng.uniform(0.65, 1.4), rng.uniform(0.7, 0.76), pick(rng, WOODS + PALES)
    pitch_x, pitch_y = w + rng.uniform(0.1, 0.6), rng.uniform(1.1, 1.5)
    seats = int(rng.integers(0, 2**31))
    parts = []
    for row in range(n_rows):
        for column in range(n_columns):
            x, y = (column - (n_columns - 1) / 2) * pitch_x, row * pitch_y
            parts.append(box(x - w / 2, y, h - 0.03, x + w / 2, y + 0.5, h, color))
            parts += legs(w / 2 - 0.04, 0.21, h - 0.03, STEEL, cx=x, cy=y + 0.25)
            for side in (-0.25, 0.25) if w > 1.0 else (0.0,):
                if rng.random() < 0.9:
                    one = chair(np.random.default_rng(seats))
                    turn = np.pi + rng.uniform(-0.3, 0.3)
                    parts.append(one.placed(x + side * w, y + rng.uniform(0.75, 0.95), yaw=turn))
            if rng.random() < 0.5:
                parts.append(clutter(rng, x - w / 2, y, x + w / 2, y + 0.5, h, 2))
    return merge(parts)


def desk(rng: np.random.Generator) -> Mesh:
    """Make a desk with monitors, keyboard, drawers and papers, an office chair before it."""
    w, d, h = rng.uniform(1.2, 1.7), rng.uniform(0.68, 0.8), rng.uniform(0.71, 0.76)
    color = pick(rng, WOODS + PALES)
    parts = [box(-w / 2, 0, h - 0.03, w / 2, d, h, color)]
    parts += legs(w / 2 - 0.05, d / 2 - 0.05, h - 0.03, STEEL, cx=0, cy=d / 2)
    side = float(rng.choice([-1, 1]))
    parts.append(box(side * (w / 2 - 0.5), 0.06, 0, side * (w / 2 - 0.08), d - 0.1, 0.6, color))
    for z in (0.06, 0.24, 0.42):
        parts.append(
            box(side * (w / 2 - 0.49), d - 0.1, z, side * (w / 2 - 0.09), d - 0.08, z + 0.16, WHITE)
        )
    n_screens = int(rng.integers(1, 3))
    for i in range(n_screens):
        x = (i - (n_screens - 1) / 2) * 0.56
        screen = merge(
            [
                box(-0.27, -0.02, 0.13, 0.27, 0.02, 0.45, DARK),
                box(-0.03, -0.05, 0.0, 0.03, -0.02, 0.3, DARK),
                box(-0.12, -0.1, 0.0, 0.12, 0.08, 0.015, DARK),
            ]
        )
        parts.append(screen.placed(x, 0.22, h, yaw=-0.35 * x + rng.uniform(-0.1, 0.1)))
    parts.append(box(-0.22, d - 0.25, h, 0.22, d - 0.11, h + 0.025, DARK))
    parts.append(clutter(rng, -w / 2, 0.05, w / 2, d, h, int(rng.integers(3, 8))))
    turn = np.pi + rng.uniform(-0.6, 0.6)
    parts.append(office_chair(rng).placed(rng.uniform(-0.15, 0.15), d + 0.42, yaw=turn))
    return merge(parts)


def office_chair(rng: np.random.Generator) -> Mesh:
    """Make a swivel chair on five feet; it faces +y about the origin."""
    color = pick(rng, CLOTHS)
    parts = [
        cylinder(0, 0, 0.1, 0.42, 0.03, DARK, sides=8),
        box(-0.24, -0.22, 0.42, 0.24, 0.25, 0.5, color),
        box(-0.22, -0.27, 0.56, 0.22, -0.2, 1.0, color),
        box(-0.03, -0.26, 0.42, 0.03, -0.22, 0.6, DARK),
    ]
    parts += [box(0, -0.025, 0.04, 0.3, 0.025, 0.1, DARK).placed(0, 0, yaw=1.257 * i)
              for i in range(5)]  # fmt: skip
    parts += [box(x - 0.03, -0.15, 0.62, x + 0.03, 0.15, 0.66, DARK) for x in (-0.27, 0.27)]
    return merge(parts)


def coffee_table(rng: np.random.Generator) -> Mesh:
    """Make a low table with books and cups."""
    w, d, h, color = rng.uniform(0.8, 1.1), rng.uniform(0.5, 0.6), 0.42, pick(rng, WOODS)
    parts = [box(-w / 2, 0, h - 0.04, w / 2, d, h, color)]
    parts.append(box(-w / 2 + 0.05, 0.05, 0.15, w / 2 - 0.05, d - 0.05, 0.17, color))
    parts += legs(w / 2 - 0.05, d / 2 - 0.05, h - 0.04, color, cx=0, cy=d / 2)
    parts.append(clutter(rng, -w / 2, 0, w / 2, d, h, int(rng.integers(3, 7))))
    return merge(parts)
