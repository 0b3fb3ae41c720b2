"""Placing furniture in a room so that nothing overlaps and passages stay free."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_bof.synthetic.furniture import Maker
from slam_bof.synthetic.meshes import Mesh
from slam_bof.synthetic.walls import Opening, on_wall, wall_length
from slam_bof.types import Array

__all__ = ["Furnisher", "distance_to_boxes"]

_TRIES = 40
_EYE_LEVEL_M = 1.9
"""Pieces above this height obstruct nobody."""


def distance_to_boxes(points: Array, boxes: Array) -> Array:
    """Return the distances (N, K) of points (N, D) to boxes (K, 2, D), low and high corners.

    >>> distance_to_boxes(np.array([[0.0, 3.0]]), np.array([[[0.0, 0.0], [1.0, 1.0]]]))
    array([[2.]])
    """
    outside = np.maximum(boxes[None, :, 0] - points[:, None], points[:, None] - boxes[None, :, 1])
    return np.asarray(np.linalg.norm(np.maximum(outside, 0.0), axis=-1))


class Furnisher:
    """Places furniture in a room, each piece at the first of some random places where it fits.

    Parameters
    ----------
    width, depth
        Inner size of the room in metres, its corner at the origin.
    openings
        Doors and windows, which furniture leaves free.
    clear
        (K, 4) columns x, y, bottom, radius that furniture leaves free, from ``bottom`` up.
    rng
        Chooses the places and the pieces.
    """

    def __init__(
        self,
        width: float,
        depth: float,
        openings: list[Opening],
        clear: Array,
        rng: np.random.Generator,
    ) -> None:
        self.width = width
        self.depth = depth
        self.rng = rng
        self._clear = clear
        self._blocked = [_front(opening, width, depth) for opening in openings]
        self._boxes: list[Array] = []
        self.meshes: list[Mesh] = []

    def boxes(self) -> Array:
        """Return the bounding boxes (K, 2, 3) of what was placed."""
        return np.array(self._boxes).reshape(-1, 2, 3)

    def against_wall(self, maker: Maker, *, n: int = 1, chance: float = 1.0) -> None:
        """Put up to ``n`` pieces with their backs to the walls, each with that chance."""
        for _ in range(n):
            if self.rng.random() > chance:
                continue
            piece = _in_front_of_wall(_make(maker, self.rng))
            low, high = piece.bounds()
            for _ in range(_TRIES):
                wall = int(self.rng.integers(4))
                free = wall_length(wall, self.width, self.depth) - (high[0] - low[0]) - 0.04
                if free < 0:
                    continue
                x = 0.02 - low[0] + self.rng.uniform(0.0, free)
                if self._put(on_wall(piece, wall, x, self.width, self.depth)):
                    break

    def in_corner(self, maker: Maker, *, n: int = 1, chance: float = 1.0) -> None:
        """Put up to ``n`` pieces against walls, tight into corners."""
        for _ in range(n):
            if self.rng.random() > chance:
                continue
            piece = _in_front_of_wall(_make(maker, self.rng))
            low, high = piece.bounds()
            for place in self.rng.permutation(8):
                wall = int(place // 2)
                length = wall_length(wall, self.width, self.depth)
                x = 0.02 - low[0] if place % 2 else length - 0.02 - high[0]
                if self._put(on_wall(piece, wall, x, self.width, self.depth)):
                    break

    def free_standing(
        self, maker: Maker, *, n: int = 1, chance: float = 1.0, margin: float = 0.5
    ) -> None:
        """Put up to ``n`` pieces away from the walls, at random angles."""
        for _ in range(n):
            if self.rng.random() > chance:
                continue
            piece = _make(maker, self.rng)
            low, high = piece.bounds()
            centred = piece.placed(*(-(low + high) / 2)[:2])
            for attempt in range(_TRIES):
                yaw = self.rng.integers(4) * np.pi / 2 + self.rng.normal(0.0, 0.08)
                turned = centred.placed(0.0, 0.0, yaw=yaw)
                reach = turned.bounds()[1][:2] + margin * (1 - attempt / _TRIES)
                room = np.array((self.width, self.depth)) - 2 * reach
                if (room < 0).any():
                    continue
                x, y = reach + self.rng.uniform(0.0, 1.0, 2) * room
                if self._put(turned.placed(x, y)):
                    break

    def near(self, maker: Maker, x: float, y: float, *, spread: float = 0.3) -> bool:
        """Place a piece around a point at a random angle; return whether there was space."""
        piece = _make(maker, self.rng)
        low, high = piece.bounds()
        centred = piece.placed(*(-(low + high) / 2)[:2])
        for _ in range(_TRIES):
            dx, dy = self.rng.normal(0.0, spread, 2)
            yaw = self.rng.uniform(0.0, 2 * np.pi)
            if self._put(centred.placed(x + dx, y + dy, yaw=yaw)):
                return True
        return False

    def hanging(self, maker: Maker, height: float) -> None:
        """Hang a piece from the ceiling, near the middle."""
        x = self.width * self.rng.uniform(0.4, 0.6)
        y = self.depth * self.rng.uniform(0.4, 0.6)
        piece = _make(maker, self.rng).placed(x, y, height)
        # A head that passes below must not touch the lamp.
        near = np.hypot(self._clear[:, 0] - x, self._clear[:, 1] - y) < 0.8
        if not near.any():
            self.meshes.append(piece)
            self._boxes.append(np.stack(piece.bounds()))

    def _put(self, mesh: Mesh) -> bool:
        bounds = np.stack(mesh.bounds())
        if (bounds[0, :2] < -0.01).any() or (
            bounds[1, :2] > (self.width + 0.01, self.depth + 0.01)
        ).any():
            return False
        for other in self._blocked + self._boxes:
            if (bounds[0] < other[1] - 0.01).all() and (bounds[1] > other[0] + 0.01).all():
                return False
        if len(self._clear) and bounds[0, 2] < _EYE_LEVEL_M:
            distance = distance_to_boxes(self._clear[:, :2], bounds[None, :, :2])[:, 0]
            if ((distance < self._clear[:, 3]) & (bounds[1, 2] > self._clear[:, 2])).any():
                return False
        self.meshes.append(mesh)
        self._boxes.append(bounds)
        return True


def _make(maker: Maker, rng: np.random.Generator) -> Mesh:
    """Make a piece of furniture that knows its kind, the name of what made it."""
    made = maker(rng)
    return made if made.piece else replace(made, piece=maker.__name__.strip("_"))


def _in_front_of_wall(piece: Mesh) -> Mesh:
    return piece.placed(0.0, max(0.0, -piece.bounds()[0][1]))


def _front(opening: Opening, width: float, depth: float) -> Array:
    """Return the box in front of an opening that stays free."""
    reach = 0.2 if opening.pane == "window" else 0.8
    half = opening.width / 2 + 0.08
    ends = np.array([(-half, 0.0, opening.bottom), (half, reach, opening.top)])
    ends = np.stack([ends, ends, ends], axis=1)
    placed = on_wall(Mesh(ends, np.zeros((2, 3))), opening.wall, opening.x, width, depth)
    return np.stack(placed.bounds())
