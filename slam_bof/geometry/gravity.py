"""Estimation of the direction of gravity from the normals of floors and walls.

Gravity is the direction to which most surfaces are either parallel or perpendicular. The
algorithm alternates between choosing these surfaces and fitting the direction (Gupta, Arbelaez
and Malik, CVPR 2013, section 3.2). A single view may show one wall only, so the normals of the
last views are combined, using their odometry poses. If odometry has lost track, the newest view
is used alone.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof.geometry.depth_view import make_view
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["GravityParams", "GravityTracker", "down_of_map", "level_frame"]


class GravityParams(Params):
    """Parameters of the estimation of gravity."""

    n_views: int = Field(
        20, gt=0, description="Number of recent views whose normals are fitted together."
    )
    n_normals: int = Field(200, gt=0, description="Largest number of normals taken from a view.")
    first_gates_deg: tuple[float, ...] = Field(
        (45.0, 20.0, 20.0, 20.0),
        min_length=1,
        description="Largest angle of a normal to the horizontal or the vertical in each iteration "
        "of the first views.",
    )
    gates_deg: tuple[float, ...] = Field(
        (20.0, 20.0),
        min_length=1,
        description="Largest angle of a normal to the horizontal or the vertical in each iteration "
        "of later views.",
    )
    n_first: int = Field(
        5, ge=0, description="Number of views at the start for which the first angles are used."
    )
    aligned_deg: float = Field(
        10.0,
        gt=0,
        le=45,
        description="Largest angle to the horizontal or the vertical at which a normal supports a "
        "direction of gravity.",
    )
    lost_margin: float = Field(
        0.25,
        ge=0,
        description="Odometry counts as lost if the direction from the newest view alone is "
        "supported by a share of its normals that is larger by more than this.",
    )


class GravityTracker:
    """Tracks the direction of gravity in the odometry frame.

    Parameters
    ----------
    gravity_odom
        (3,) initial direction of gravity in the odometry frame, correct to about 40 degrees. It
        is (0, 1, 0) if the first camera is about upright and defines the odometry frame.
    never_lost
        Whether all poses are correct, such as those of a finished map. Gravity is then never
        estimated from a single view, which can fail for a camera that looks down steeply.
    """

    def __init__(
        self,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        params: GravityParams | None = None,
        *,
        never_lost: bool = False,
    ) -> None:
        self.params = params or GravityParams()
        gravity = np.asarray(gravity_odom, dtype=np.float64)
        self._gravity_odom = gravity / np.linalg.norm(gravity)
        self._lost_margin = np.inf if never_lost else self.params.lost_margin
        self._normals_odom: deque[Array] = deque(maxlen=self.params.n_views)

    def update(self, normals_camera: NDArray[np.floating], T_odom_camera: Pose) -> Array:
        """Add the normals (N, 3) of a view, N >= 0; return gravity (3,) in its camera frame."""
        p, R = self.params, T_odom_camera[:3, :3]
        if len(normals_camera):
            n = len(normals_camera)
            chosen = np.linspace(0, n - 1, min(p.n_normals, n))
            normals_odom = normals_camera[chosen.astype(np.intp)] @ R.T
            self._normals_odom.append(normals_odom)
            is_first = len(self._normals_odom) <= p.n_first
            gates = p.first_gates_deg if is_first else p.gates_deg
            recent = np.concatenate(self._normals_odom)
            self._gravity_odom = _fit(recent, self._gravity_odom, gates)
            single_view = _fit(normals_odom, R[:, 1], p.first_gates_deg)
            support = _support(normals_odom, self._gravity_odom, p.aligned_deg)
            single_support = _support(normals_odom, single_view, p.aligned_deg)
            if single_support > support + self._lost_margin:
                self._normals_odom.clear()
                self._normals_odom.append(normals_odom)
                self._gravity_odom = single_view
        return np.asarray(R.T @ self._gravity_odom)


def down_of_map(
    frames: Iterable[DepthFrame], T_map_camera: Array, guess: ArrayLike = (0.0, 1.0, 0.0)
) -> Array:
    """Return the direction of gravity (3,) in the map frame, from the normals of all keyframes.

    Parameters
    ----------
    frames, T_map_camera
        The K keyframes and their poses (K, 4, 4).
    guess
        (3,) rough direction of gravity in the map frame.
    """
    p, down = GravityParams(), np.asarray(guess, dtype=np.float64)
    normals_map = [np.empty((0, 3))]
    for frame, T in zip(frames, T_map_camera, strict=True):
        normals = make_view(frame).known_normals()
        normals_map.append(normals[:: -(-len(normals) // p.n_normals) or 1] @ T[:3, :3].T)
    return _fit(np.concatenate(normals_map), down / np.linalg.norm(down), p.first_gates_deg)


def level_frame(gravity_camera: Array) -> Array:
    """Return ``R_level_camera`` (3, 3): y is down, z is the optical axis made horizontal.

    For a camera that looks straight down or up, z is the direction of the top or bottom of its
    image instead.
    """
    down = gravity_camera / np.linalg.norm(gravity_camera)
    ahead = np.array([0.0, 0.0, 1.0]) - down * down[2]
    if np.linalg.norm(ahead) < 0.1:
        top = np.array([0.0, -np.sign(down[2]), 0.0])
        ahead = top - down * (down @ top)
    ahead /= np.linalg.norm(ahead)
    return np.stack([np.cross(down, ahead), down, ahead])


def _fit(normals: Array, down: Array, gates_deg: Sequence[float]) -> Array:
    """Return the direction most perpendicular to wall normals and parallel to floor normals.

    ``down`` is the initial direction. Each iteration minimises the sum of the squared cosines to
    the normals of walls and of the squared sines to the normals of floors. The direction of the
    last iteration counts as one floor normal, which settles what the surfaces leave undetermined.
    """
    for gate_rad in np.radians(gates_deg):
        cosine = np.abs(normals @ down)
        floors = normals[cosine > np.cos(gate_rad)]
        walls = normals[cosine < np.sin(gate_rad)]
        scatter = walls.T @ walls - floors.T @ floors - np.outer(down, down)
        _, vectors = np.linalg.eigh(scatter)
        down = vectors[:, 0] * np.sign(vectors[:, 0] @ down)
    return down


def _support(normals: Array, down: Array, aligned_deg: float) -> float:
    """Return the share of normals that are horizontal or vertical if ``down`` is gravity."""
    cosine, aligned_rad = np.abs(normals @ down), np.radians(aligned_deg)
    return float(((cosine > np.cos(aligned_rad)) | (cosine < np.sin(aligned_rad))).mean())
