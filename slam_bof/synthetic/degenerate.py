"""Scenes whose surfaces leave directions of motion open, and a camera that moves through them.

In a corridor without an end in range, depth does not show how far the camera moved along it, nor in
front of a wall how far it slid past. The map of such a motion shows whether registration notices
this, with odometry that is exact, that drifts, or that is itself computed from depth.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slam_bof.synthetic.depth_noise import SENSORS, with_holes
from slam_bof.synthetic.meshes import Mesh, box, merge
from slam_bof.synthetic.rooms import make_room
from slam_bof.synthetic.scene import Scene3D
from slam_bof.synthetic.tour import camera_poses
from slam_bof.types import Array, DepthFrame

__all__ = ["DEGENERATE_SCENES", "MOTIONS", "DegenerateCase", "render_case"]

GREY = (0.7, 0.7, 0.7)
SWAY_RAD = float(np.radians(2.0))
"""Amplitude by which a hand-held camera turns to and fro about its viewing direction."""
SWAY_M = 0.015
ROUND_S = 12.0
GLASS_HOLES = 0.7
"""Share of the pixels that are lost before glass."""

MOTIONS = ("handheld", "wheeled")
"""A hand sways and turns by some degrees; wheels move evenly."""

Path = tuple[Array, Array, Array]
"""Positions (N, 3), yaw (N,) and pitch (N,), as ``camera_poses`` takes them."""


class DegenerateScene(NamedTuple):
    """What is looked at, and the way past it at times (N,) in seconds."""

    make_mesh: Callable[[], Mesh]
    path: Callable[[Array], Path]
    duration_s: float = 4.0


@dataclass(frozen=True, slots=True)
class DegenerateCase:
    """One way of looking at one scene.

    ``scene`` is one of ``DEGENERATE_SCENES``, ``motion`` of ``MOTIONS``, ``sensor`` of
    ``depth_noise.SENSORS``; the camera takes ``rate_hz`` frames a second.
    """

    scene: str
    motion: str = "handheld"
    sensor: str = "kinect"
    rate_hz: float = 30.0

    @property
    def name(self) -> str:
        """Return the case in one word."""
        return f"{self.scene}-{self.motion}-{self.sensor}-{self.rate_hz:g}"

    def poses(self) -> Array:
        """Return ``T_world_camera`` (N, 4, 4) of each frame.

        >>> DegenerateCase("corridor", rate_hz=10).poses().shape
        (40, 4, 4)
        """
        scene = DEGENERATE_SCENES[self.scene]
        t = np.arange(round(scene.duration_s * self.rate_hz)) / self.rate_hz
        position, yaw, pitch = scene.path(t)
        if self.motion == "wheeled":
            return camera_poses(position, yaw, pitch)
        # Incommensurable rates, so that no two frames see quite the same.
        sway = SWAY_M * np.stack([np.sin(3.1 * t), np.sin(3.7 * t), np.sin(5.0 * t)], axis=-1)
        return camera_poses(
            position + sway,
            yaw + SWAY_RAD * np.sin(4.0 * t),
            pitch + 0.7 * SWAY_RAD * np.sin(6.1 * t),
            0.5 * SWAY_RAD * np.sin(5.3 * t),
        )


def render_case(case: DegenerateCase, *, seed: int = 0) -> Iterator[DepthFrame]:
    """Render the frames of a case, one for each of ``case.poses()``.

    Parameters
    ----------
    case
        What is looked at, how and with what.
    seed
        Of the sensor's noise; the same seed gives the same bytes.
    """
    sensor = SENSORS[case.sensor]
    scene = Scene3D(DEGENERATE_SCENES[case.scene].make_mesh(), sensor.intrinsics)
    rng = np.random.default_rng(seed)
    for k, T_world_camera in enumerate(case.poses()):
        depth_mm = sensor.measure(scene.view(T_world_camera), rng)
        if case.scene == "glass":
            depth_mm = with_holes(depth_mm, GLASS_HOLES, rng)
        yield DepthFrame(k / case.rate_hz, depth_mm, sensor.intrinsics)


def _plate(axis: int, at: float, half_m: float = 60.0) -> Mesh:
    """Return a large thin plate square to an axis, one face at ``at``."""
    low, high = np.full(3, -half_m), np.full(3, half_m)
    low[axis], high[axis] = (at, at + 0.01) if at > 0 else (at - 0.01, at)
    return box(low[0], low[1], low[2], high[0], high[1], high[2], GREY)


def _floor() -> Mesh:
    return _plate(2, 0.0)


def _corner() -> Mesh:
    return merge([_plate(0, 2.2), _plate(1, 2.2)])


def _cabinet() -> Mesh:
    return merge([_floor(), box(-0.4, -0.25, 0.0, 0.4, 0.25, 0.9, GREY)])


def _shop_window() -> Mesh:
    return merge([_plate(0, 3.0), _floor(), box(2.2, -1.0, 0.0, 2.8, -0.2, 1.0, GREY)])


def _stairwell() -> Mesh:
    """Return 18 steps up along x, between two walls."""
    steps = [box(0.28 * k, -1.0, 0.17 * k, 6.0, 1.0, 0.17 * (k + 1), GREY) for k in range(18)]
    return merge([*steps, _plate(1, -1.0), _plate(1, 1.0), _floor()])


def _straight(
    start: tuple[float, float, float],
    velocity: tuple[float, float, float],
    yaw: float = 0.0,
    pitch: float = 0.0,
) -> Callable[[Array], Path]:
    """Return the way from ``start`` at an even ``velocity``, in m/s."""

    def path(t: Array) -> Path:
        position = np.array(start) + np.outer(t, velocity)
        return position, np.full_like(t, yaw), np.full_like(t, pitch)

    return path


def _round(t: Array) -> Path:
    """Go once round the origin in ``ROUND_S``, looking at it from 1.8 m away."""
    angle = 2.0 * np.pi * t / ROUND_S
    position = np.stack([1.8 * np.cos(angle), 1.8 * np.sin(angle), np.full_like(t, 1.3)], axis=-1)
    return position, angle + np.pi, np.full_like(t, 0.5)


DEGENERATE_SCENES = {
    "corridor": DegenerateScene(
        lambda: box(-60, -1.0, 0.0, 60, 1.0, 2.6, GREY), _straight((0, 0, 1.3), (0.4, 0, 0))
    ),
    "wall": DegenerateScene(lambda: _plate(0, 2.5), _straight((0, 0, 0), (0, 0.4, 0))),
    "floor": DegenerateScene(_floor, _straight((0, 0, 1.2), (0.4, 0, 0), pitch=1.3)),
    "ceiling": DegenerateScene(
        lambda: _plate(2, 2.6), _straight((0, 0, 1.0), (0.4, 0, 0), pitch=-1.3)
    ),
    "corner": DegenerateScene(
        _corner, _straight((0, 0, 0), (0.1, 0.1, 0.2), yaw=float(np.radians(45)))
    ),
    "box": DegenerateScene(_cabinet, _round, duration_s=ROUND_S),
    "glass": DegenerateScene(_shop_window, _straight((0, -0.5, 1.3), (0, 0.3, 0), pitch=0.2)),
    "stairs": DegenerateScene(_stairwell, _straight((-0.5, 0, 1.4), (0.4, 0, 0.24), pitch=0.4)),
    "hall": DegenerateScene(
        lambda: box(-15.0, -10.0, 0.0, 15.0, 10.0, 6.0, GREY),
        _straight((0, 0, 1.0), (0.5, 0, 0), pitch=0.3),
    ),
    "room": DegenerateScene(
        lambda: make_room("office", seed=3).mesh,
        _straight((1.0, 1.5, 1.4), (0.1, 0.1, 0), yaw=0.6, pitch=0.25),
    ),
}
"""World frame: z up. ``room`` is furnished and leaves nothing open: what all must do well in."""
