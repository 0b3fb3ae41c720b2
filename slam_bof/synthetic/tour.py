"""Hand-held camera motion: smooth walks through way points, and quick turns on the spot.

World frame: z up. ``yaw`` is counter-clockwise from +x as seen from above, ``pitch`` positive
looking down, ``roll`` positive with the camera's right side down.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.ndimage import gaussian_filter1d

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["FRAME_RATE_HZ", "TURN_RATE", "Waypoint", "camera_poses", "spin", "walk"]

FRAME_RATE_HZ = 30.0
TURN_RATE = float(np.deg2rad(63.0))
"""Typical yaw rate of a person with a camera, in rad/s."""


@dataclass(frozen=True, slots=True)
class Waypoint:
    """Position of the camera in metres, and its angles in radians (yaw is not wrapped)."""

    x: float
    y: float
    yaw: float
    z: float = 1.45
    pitch: float = 0.25


def camera_poses(
    position: ArrayLike, yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike = 0.0
) -> Pose:
    """Compose ``T_world_camera`` (..., 4, 4) of positions (..., 3) and angles (...).

    >>> looking_along_x = camera_poses([0.0, 0.0, 1.5], 0.0, 0.0)
    >>> np.allclose(looking_along_x[:3, 2], (1.0, 0.0, 0.0))
    True
    """
    position, yaw, pitch, roll = np.broadcast_arrays(
        np.asarray(position, dtype=np.float64),
        *(np.asarray(angle, dtype=np.float64)[..., None] for angle in (yaw, pitch, roll)),
    )
    yaw, pitch, roll = yaw[..., 0], pitch[..., 0], roll[..., 0]
    zero = np.zeros_like(yaw)
    forward = np.stack(
        [np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), -np.sin(pitch)], axis=-1
    )
    level = np.stack([np.sin(yaw), -np.cos(yaw), zero], axis=-1)
    upright = np.cross(forward, level)
    c, s = np.cos(roll)[..., None], np.sin(roll)[..., None]
    T = np.zeros((*yaw.shape, 4, 4))
    T[..., :3, 0] = c * level + s * upright
    T[..., :3, 1] = c * upright - s * level
    T[..., :3, 2] = forward
    T[..., :3, 3] = position
    T[..., 3, 3] = 1.0
    return T


def walk(
    waypoints: list[Waypoint],
    *,
    speed_m_s: float = 0.95,
    turn_rate: float = TURN_RATE,
    smoothing_s: float = 0.3,
    seed: int = 0,
) -> Array:
    """Walk through the way points with a hand-held camera.

    Each leg takes as long as speed and turn rate allow; the motion is then smoothed, which
    can only slow it down and keeps it within the convex hull of neighbouring way points.

    Parameters
    ----------
    waypoints
        The way points, at least two.
    speed_m_s, turn_rate
        Largest speed (m/s) and yaw rate (rad/s), without tremor.
    smoothing_s
        Standard deviation in time of the smoothing.
    seed
        Seed of the tremor.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``.

    Raises
    ------
    ValueError
        If there are fewer than two way points.
    """
    if len(waypoints) < 2:
        raise ValueError(f"a walk needs at least 2 way points, got {len(waypoints)}")
    keys = np.array([(w.x, w.y, w.z, w.yaw, w.pitch) for w in waypoints])
    step = np.diff(keys, axis=0)
    duration = np.maximum(
        np.linalg.norm(step[:, :3], axis=1) / speed_m_s,
        np.linalg.norm(step[:, 3:], axis=1) / turn_rate,
    )
    end = np.concatenate([[0.0], np.cumsum(duration)])
    stamps = np.arange(0.0, end[-1], 1.0 / FRAME_RATE_HZ)
    path = np.stack([np.interp(stamps, end, key) for key in keys.T], axis=1)
    path = gaussian_filter1d(path, smoothing_s * FRAME_RATE_HZ, axis=0, mode="nearest")
    return _shaken(path, np.random.default_rng(seed))


def spin(
    x: float,
    y: float,
    *,
    rate_deg_s: float = 90.0,
    angle_deg: float = 360.0,
    z: float = 1.45,
    yaw: float = 0.0,
    pitch: float = 0.15,
    seed: int = 0,
) -> Array:
    """Turn quickly on the spot, with a pause of half a second before and after.

    Returns
    -------
    Array
        ``T_world_camera`` (N, 4, 4) at ``FRAME_RATE_HZ``; the camera moves on a circle of
        0.25 m around the body.
    """
    turn = np.arange(0.0, abs(angle_deg), rate_deg_s / FRAME_RATE_HZ)
    rest = round(0.5 * FRAME_RATE_HZ)
    angle = np.sign(angle_deg) * np.concatenate([np.zeros(rest), turn, np.full(rest, turn[-1])])
    heading = gaussian_filter1d(yaw + np.deg2rad(angle), 3.0, mode="nearest")
    path = np.stack(
        [
            x + 0.25 * np.cos(heading),
            y + 0.25 * np.sin(heading),
            np.full_like(heading, z),
            heading,
            np.full_like(heading, pitch),
        ],
        axis=1,
    )
    return _shaken(path, np.random.default_rng(seed))


def _shaken(path: Array, rng: np.random.Generator) -> Array:
    """Add the motion of steps and the tremor of hands to a path (N, 5) of x, y, z, yaw, pitch."""
    n = len(path)
    speed = np.linalg.norm(np.gradient(path[:, :2], axis=0), axis=1) * FRAME_RATE_HZ
    phase = 2 * np.pi * 1.7 * np.arange(n) / FRAME_RATE_HZ
    bob = 0.012 * np.minimum(speed / 0.8, 1.0) * np.sin(phase)
    # Low-pass noise of unit variance, without jumps.
    noise = gaussian_filter1d(rng.standard_normal((n, 6)), 6.0, axis=0, mode="wrap")
    noise *= np.sqrt(2.0 * np.sqrt(np.pi) * 6.0)
    position = path[:, :3] + 0.012 * noise[:, :3]
    position[:, 2] += bob
    angles = np.deg2rad((0.6, 0.7, 0.8)) * noise[:, 3:]
    T = camera_poses(position, path[:, 3] + angles[:, 0], path[:, 4] + angles[:, 1], angles[:, 2])
    # Files keep 9 digits, and readers expect orthonormal rotations.
    return se3.nearest_pose(T)
