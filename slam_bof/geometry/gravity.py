"""Which way is down, told by the surfaces in view: floors and walls agree on it.

The direction to which most surfaces are either parallel or square, found by turns of choosing
those surfaces and of fitting the direction (Gupta, Arbelaez and Malik, CVPR 2013, section 3.2).
A single view may show one wall; normals of the last few views, joined by odometry, show more.
Should odometry lose track, what a view shows by itself is taken instead.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.geometry.depth_view import make_view
from slam_bof.types import Array, DepthFrame, Pose

__all__ = ["GravityTracker", "down_of_map", "level_frame"]

N_VIEWS = 20
"""Views whose normals are fitted together."""
N_NORMALS = 200
"""Normals that a view gives."""
FIRST_GATES_RAD = tuple(np.radians((45.0, 20.0, 20.0, 20.0)))
"""How far a normal may be from level or plumb to count, in each turn, while little is known."""
GATES_RAD = tuple(np.radians((20.0, 20.0)))
N_FIRST = 5
"""Views for which little is known."""
PLUMB_RAD = np.radians(10.0)
LOST_MARGIN = 0.25
"""Odometry has lost the direction where, of a view, so many more normals are level or plumb by
what an upright camera makes of that view alone."""


class GravityTracker:
    """Keeps the direction of gravity in the odometry's frame up to date.

    Parameters
    ----------
    gravity_odom
        (3,) direction down in the odometry's frame, known to within some 40 degrees. Where the
        first camera is held about upright and is the odometry's frame, that is (0, 1, 0).
    never_lost
        Whether poses are known to be right, as those of a finished map are. No view is then taken
        by itself, which for one that looks down steeply may be a mistake.
    """

    def __init__(
        self, gravity_odom: ArrayLike = (0.0, 1.0, 0.0), *, never_lost: bool = False
    ) -> None:
        gravity = np.asarray(gravity_odom, dtype=np.float64)
        self._gravity_odom = gravity / np.linalg.norm(gravity)
        self._lost_margin = np.inf if never_lost else LOST_MARGIN
        self._normals_odom: deque[Array] = deque(maxlen=N_VIEWS)

    def update(self, normals_camera: NDArray[np.floating], T_odom_camera: Pose) -> Array:
        """Take a view's surface normals (N, 3), any N; return down (3,) in its camera frame."""
        R = T_odom_camera[:3, :3]
        if len(normals_camera):
            some = np.linspace(0, len(normals_camera) - 1, min(N_NORMALS, len(normals_camera)))
            seen_odom = normals_camera[some.astype(np.intp)] @ R.T
            self._normals_odom.append(seen_odom)
            gates = FIRST_GATES_RAD if len(self._normals_odom) <= N_FIRST else GATES_RAD
            joined = np.concatenate(self._normals_odom)
            self._gravity_odom = _fit(joined, self._gravity_odom, gates)
            afresh = _fit(seen_odom, R[:, 1], FIRST_GATES_RAD)
            if (
                _share(seen_odom, afresh)
                > _share(seen_odom, self._gravity_odom) + self._lost_margin
            ):
                self._normals_odom.clear()
                self._normals_odom.append(seen_odom)
                self._gravity_odom = afresh
        return np.asarray(R.T @ self._gravity_odom)


def down_of_map(
    frames: Iterable[DepthFrame], T_map_camera: Array, guess: ArrayLike = (0.0, 1.0, 0.0)
) -> Array:
    """Return down (3,) in a map's frame, as its keyframes' surfaces tell together.

    Parameters
    ----------
    frames, T_map_camera
        K keyframes and their poses (K, 4, 4).
    guess
        (3,) roughly down in the map's frame.
    """
    down = np.asarray(guess, dtype=np.float64)
    seen = [np.empty((0, 3))]
    for frame, T in zip(frames, T_map_camera, strict=True):
        normals = make_view(frame).known_normals()
        seen.append(normals[:: -(-len(normals) // N_NORMALS) or 1] @ T[:3, :3].T)
    return _fit(np.concatenate(seen), down / np.linalg.norm(down), FIRST_GATES_RAD)


def level_frame(gravity_camera: Array) -> Array:
    """Return ``R_level_camera`` (3, 3): y is down, z the optical axis made horizontal.

    A camera that looks straight down or up has no such axis; the top or bottom of its image
    stands in for it.
    """
    down = gravity_camera / np.linalg.norm(gravity_camera)
    ahead = np.array([0.0, 0.0, 1.0]) - down * down[2]
    if np.linalg.norm(ahead) < 0.1:
        top = np.array([0.0, -np.sign(down[2]), 0.0])
        ahead = top - down * (down @ top)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(down, ahead), down, ahead])


def _fit(normals: Array, down: Array, gates_rad: Sequence[float]) -> Array:
    """Return the direction that is most square to walls and along floors, starting with ``down``.

    In each turn it minimises the sum of squared cosines to the walls' normals and of squared
    sines to the floors'. The direction so far counts as one floor, and decides where surfaces
    leave it open.
    """
    for gate_rad in gates_rad:
        cosine = np.abs(normals @ down)
        floors = normals[cosine > np.cos(gate_rad)]
        walls = normals[cosine < np.sin(gate_rad)]
        scatter = walls.T @ walls - floors.T @ floors - np.outer(down, down)
        _, vectors = np.linalg.eigh(scatter)
        down = vectors[:, 0] * np.sign(vectors[:, 0] @ down)
    return down


def _share(normals: Array, down: Array) -> float:
    """Return the share of normals that are level or plumb, if that is down."""
    cosine = np.abs(normals @ down)
    return float(((cosine > np.cos(PLUMB_RAD)) | (cosine < np.sin(PLUMB_RAD))).mean())
