"""Furniture built of boxes and cylinders, each piece a little different with the generator.

A piece stands on z = 0 with its back on y = 0 and its front towards +y, x along the wall
and centred on 0. Metres.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slam_bof.synthetic.meshes import Color, Mesh, box, cylinder, ellipsoid, merge

__all__ = ["Maker", "clutter"]

Maker = Callable[[np.random.Generator], Mesh]
"""What makes a piece of furniture."""

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


def _legs(x: float, y: float, z: float, color: Color, *, cx: float, cy: float) -> list[Mesh]:
    r = 0.025
    return [
        box(cx + sx * x - r, cy + sy * y - r, 0, cx + sx * x + r, cy + sy * y + r, z, color)
        for sx in (-1, 1)
        for sy in (-1, 1)
    ]


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


def chair(rng: np.random.Generator) -> Mesh:
    """Make a chair; it faces +y."""
    color, seat = pick(rng, WOODS), rng.uniform(0.43, 0.47)
    parts = _legs(0.18, 0.18, seat, color, cx=0, cy=0.22)
    parts.append(box(-0.21, 0.0, seat, 0.21, 0.43, seat + 0.04, color))
    parts += [box(x - 0.02, 0, seat, x + 0.02, 0.035, 0.9, color) for x in (-0.19, 0.19)]
    parts.append(box(-0.21, 0, 0.62, 0.21, 0.03, 0.92, color))
    return merge(parts)


def _table_set(rng: np.random.Generator, w: float, d: float, n_side: int, ends: bool) -> Mesh:
    h, color = rng.uniform(0.72, 0.76), pick(rng, WOODS)
    gap, cy = 0.5, 0.5 + d / 2
    parts = [box(-w / 2, cy - d / 2, h - 0.035, w / 2, cy + d / 2, h, color)]
    parts += _legs(w / 2 - 0.06, d / 2 - 0.06, h - 0.03, color, cx=0, cy=cy)
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


def desk(rng: np.random.Generator) -> Mesh:
    """Make a desk with monitors, keyboard, drawers and papers, an office chair before it."""
    w, d, h = rng.uniform(1.2, 1.7), rng.uniform(0.68, 0.8), rng.uniform(0.71, 0.76)
    color = pick(rng, WOODS + PALES)
    parts = [box(-w / 2, 0, h - 0.03, w / 2, d, h, color)]
    parts += _legs(w / 2 - 0.05, d / 2 - 0.05, h - 0.03, STEEL, cx=0, cy=d / 2)
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
    parts += _legs(w / 2, 0.95, 0.12, wood, cx=0, cy=1.02)
    for i in range(n_pillows):
        x = (i - (n_pillows - 1) / 2) * w / 2
        parts.append(ellipsoid((x, 0.33, 0.52), (0.3, 0.22, 0.09), WHITE))
    parts.append(ellipsoid((0.1 * w, 1.5, 0.55), (0.3, 0.25, rng.uniform(0.05, 0.16)), cloth))
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
            *_legs(0.33, 0.33, 0.1, DARK, cx=0, cy=0.4),
        ]
    )


def coffee_table(rng: np.random.Generator) -> Mesh:
    """Make a low table with books and cups."""
    w, d, h, color = rng.uniform(0.8, 1.1), rng.uniform(0.5, 0.6), 0.42, pick(rng, WOODS)
    parts = [box(-w / 2, 0, h - 0.04, w / 2, d, h, color)]
    parts.append(box(-w / 2 + 0.05, 0.05, 0.15, w / 2 - 0.05, d - 0.05, 0.17, color))
    parts += _legs(w / 2 - 0.05, d / 2 - 0.05, h - 0.04, color, cx=0, cy=d / 2)
    parts.append(clutter(rng, -w / 2, 0, w / 2, d, h, int(rng.integers(3, 7))))
    return merge(parts)


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
        *_legs(w / 2 - 0.04, 0.11, h - 0.1, color, cx=0, cy=0.15),
        clutter(rng, -w / 2, 0, w / 2, 0.3, h, 4),
    ]
    return merge(parts)


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


def ceiling_lamp(rng: np.random.Generator) -> Mesh:
    """Make a lamp that hangs from z = 0 (the ceiling) downwards."""
    drop, r = rng.uniform(0.25, 0.6), rng.uniform(0.15, 0.28)
    return merge(
        [
            cylinder(0, 0, -drop, 0, 0.01, DARK, sides=6),
            cylinder(0, 0, -drop - 0.2, -drop, r, WHITE, top_radius=r / 3),
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
