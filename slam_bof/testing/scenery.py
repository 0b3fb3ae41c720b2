"""What the checks show: a slow turn in a furnished room, and frames that show nothing."""

from __future__ import annotations

import functools

import numpy as np

from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, distance_to_boxes, make_room, sense, spin
from slam_bof.types import INVALID_DEPTH_MM, Array, DepthFrame, Pose

__all__ = ["blind", "example_frames", "expect", "expect_rigid", "pair_of_views"]

FRAMES_PER_S = 30.0
TURN_DEG_S = 45.0
N_STANDING = 8
"""Number of frames at the beginning of the turn, where the camera stands, that are left out."""
YAW_RAD = 1.0
"""Yaw at which the turn begins: surfaces face all ways there, so that no direction is left open."""
BEHIND = se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))


def expect(holds: bool, message: str) -> None:
    """Raise ``AssertionError`` with the message unless it holds, whatever Python's options."""
    if not holds:
        raise AssertionError(message)


def expect_rigid(T: object, what: str) -> None:
    """Check that something is a pose (4, 4) of float64."""
    expect(
        isinstance(T, np.ndarray) and T.shape == (4, 4) and T.dtype == np.float64,
        f"{what} must be a (4, 4) array of float64, got {getattr(T, 'shape', type(T).__name__)}",
    )
    assert isinstance(T, np.ndarray)
    expect(bool(np.isfinite(T).all()), f"{what} must be finite")
    off = np.abs(T[:3, :3].T @ T[:3, :3] - np.eye(3)).max()
    expect(
        off < 1e-6 and np.linalg.det(T[:3, :3]) > 0 and (T[3] == [0, 0, 0, 1]).all(),
        f"{what} must be a rotation and a translation (R'R is off by {off:.2g}); "
        "slam_bof.geometry.se3.nearest_pose helps",
    )


def example_frames(n_frames: int = 20) -> tuple[list[DepthFrame], Array]:
    """Return frames of a slow turn in a furnished room, and their true poses.

    Parameters
    ----------
    n_frames
        At most 60.

    Returns
    -------
    list of DepthFrame
        At 30 Hz, through the model of a structured-light camera, uint16 mm.
    Array
        (n_frames, 4, 4) ``T_first_camera``.
    """
    _, standpoint = _room()
    turn = spin(*standpoint, rate_deg_s=TURN_DEG_S, angle_deg=90.0, yaw=YAW_RAD)
    T_world_camera = turn[N_STANDING:]
    frames = [_look(T, index) for index, T in enumerate(T_world_camera[:n_frames])]
    return frames, se3.inverse(T_world_camera[0]) @ T_world_camera[: len(frames)]


def blind(frame: DepthFrame, *, as_float: bool = False) -> tuple[DepthFrame, DepthFrame]:
    """Return the frame with every pixel missing, in both ways that its type has for that."""
    shape = frame.depth.shape
    depths: tuple[Array, ...] = (
        (np.zeros(shape), np.full(shape, np.nan))
        if as_float
        else (np.zeros(shape, np.uint16), np.full(shape, INVALID_DEPTH_MM, np.uint16))
    )
    first, second = (DepthFrame(frame.stamp_s, depth, frame.intrinsics) for depth in depths)
    return first, second


def pair_of_views() -> tuple[DepthFrame, DepthFrame, DepthFrame, Pose]:
    """Return a query, a match, a view the other way, and the true ``T_match_query``."""
    _, standpoint = _room()
    T_world_match = spin(*standpoint, angle_deg=180.0)[0]
    T_match_query = se3.exp(np.array([0.05, 0.2, -0.03, 0.15, -0.05, 0.1]))
    query, match, behind = (
        _look(T_world_match @ T, index)
        for index, T in enumerate((T_match_query, np.eye(4), BEHIND))
    )
    return query, match, behind, T_match_query


def _look(T_world_camera: Pose, index: int) -> DepthFrame:
    scene, _ = _room()
    seen = scene.view(T_world_camera)
    depth = sense(seen.depth_m, seen.returned, np.random.default_rng(index))
    return DepthFrame(index / FRAMES_PER_S, depth, scene.intrinsics)


@functools.cache
def _room() -> tuple[Scene3D, tuple[float, float]]:
    """Return a living room, and the place nearest to its middle that furniture leaves free."""
    room = make_room("living_room", seed=3)
    width, depth, _ = room.size
    x, y = np.meshgrid(np.linspace(0.6, width - 0.6, 25), np.linspace(0.6, depth - 0.6, 25))
    places = np.stack([x.ravel(), y.ravel(), np.full(x.size, 1.3)], axis=1)
    free = places[distance_to_boxes(places, room.boxes).min(axis=1) > 0.3]
    off_m = np.linalg.norm(free[:, :2] - [width / 2, depth / 2], axis=1)
    nearest = free[int(np.argmin(off_m))]
    return Scene3D(room.mesh), (float(nearest[0]), float(nearest[1]))
