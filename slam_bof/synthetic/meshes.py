"""Triangle meshes with a colour per triangle: boxes, cylinders and ellipsoids."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from slam_bof.types import Array

__all__ = ["Color", "Mesh", "box", "cylinder", "ellipsoid", "merge"]

Color = tuple[float, float, float]
"""Albedo red, green, blue in [0, 1]."""

_BOX_CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
_BOX_FACES = np.array(
    [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]
)  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Triangles (F, 3, 3), corner by corner in metres, and their colours (F, 3).

    ``piece`` is the kind of furniture that it is, empty if it is none or several.
    """

    triangles: Array = field(default_factory=lambda: np.empty((0, 3, 3)))
    albedo: Array = field(default_factory=lambda: np.empty((0, 3)))
    piece: str = ""

    def __len__(self) -> int:
        """Return the number of triangles."""
        return len(self.triangles)

    def bounds(self) -> tuple[Array, Array]:
        """Return the lowest and the highest x, y, z."""
        corners = self.triangles.reshape(-1, 3)
        return corners.min(axis=0), corners.max(axis=0)

    def placed(self, x: float, y: float, z: float = 0.0, *, yaw: float = 0.0) -> Mesh:
        """Turn by ``yaw`` (radians) about the vertical through the origin, then move."""
        c, s = np.cos(yaw), np.sin(yaw)
        R = np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])
        return Mesh(self.triangles @ R.T + (x, y, z), self.albedo, self.piece)


def merge(meshes: Iterable[Mesh]) -> Mesh:
    """Join meshes into one."""
    parts = list(meshes)
    if not parts:
        return Mesh()
    return Mesh(
        np.concatenate([part.triangles for part in parts]),
        np.concatenate([part.albedo for part in parts]),
    )


def _mesh(triangles: Array, color: Color) -> Mesh:
    return Mesh(triangles, np.tile(np.asarray(color, dtype=np.float64), (len(triangles), 1)))


def box(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, color: Color) -> Mesh:
    """Make the box between two opposite corners.

    >>> len(box(0, 0, 0, 1, 1, 1, (0.5, 0.5, 0.5)))
    12
    """
    low = np.array((x0, y0, z0))
    corners = low + _BOX_CORNERS * (np.array((x1, y1, z1)) - low)
    return _mesh(corners[_BOX_FACES], color)


def cylinder(
    x: float,
    y: float,
    z0: float,
    z1: float,
    radius: float,
    color: Color,
    *,
    top_radius: float | None = None,
    sides: int = 14,
) -> Mesh:
    """Make an upright closed cylinder, or a frustum with another ``top_radius``."""
    angle = 2 * np.pi * np.arange(sides + 1) / sides
    rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    low = np.column_stack([rim * radius + (x, y), np.full(sides + 1, z0)])
    top = radius if top_radius is None else top_radius
    high = np.column_stack([rim * top + (x, y), np.full(sides + 1, z1)])
    a, b, c, d = low[:-1], low[1:], high[:-1], high[1:]
    bottom = np.broadcast_to((x, y, z0), a.shape)
    lid = np.broadcast_to((x, y, z1), a.shape)
    faces = [(a, b, d), (a, d, c), (bottom, b, a), (lid, c, d)]
    return _mesh(np.concatenate([np.stack(face, axis=1) for face in faces]), color)


def ellipsoid(
    center: tuple[float, float, float], radii: tuple[float, float, float], color: Color
) -> Mesh:
    """Make a coarse ellipsoid, its axes along x, y and z."""
    around = np.linspace(0.0, 2 * np.pi, 13)
    upward = np.linspace(-np.pi / 2, np.pi / 2, 8)
    grid = np.stack(
        [
            np.outer(np.cos(upward), np.cos(around)),
            np.outer(np.cos(upward), np.sin(around)),
            np.outer(np.sin(upward), np.ones_like(around)),
        ],
        axis=-1,
    ) * np.asarray(radii) + np.asarray(center)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    faces = np.concatenate(
        [np.stack([a, b, d], axis=-2).reshape(-1, 3, 3), np.stack([a, d, c], -2).reshape(-1, 3, 3)]
    )
    return _mesh(faces, color)
