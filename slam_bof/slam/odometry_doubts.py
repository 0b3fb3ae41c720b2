"""Whether the poses of an odometry are what they are taken for.

Tracking follows depth even where odometry is in another convention, so that a wrong convention
does not show by itself; the map is only worse. The turns of odometry beside those of tracking tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from slam_bof.geometry import AXES, se3
from slam_bof.slam.config import Config
from slam_bof.tracking import KeyframeSelector, Tracker
from slam_bof.types import LOST, Array, DepthFrame, FramePose, Pose

__all__ = ["OdometryCheck", "find_odometry_doubts"]

MIN_TURN_RAD = np.radians(3.0)
MIN_SHIFT_M = 0.1
"""A motion is measured once tracking has turned or shifted by this much."""
MAX_FRAMES = 30
"""Motions over more frames than these are left out: tracking may have drifted as well."""
MIN_MOTIONS = 20
MAX_ERROR = 0.5
"""Share of a turn by which odometry may be off, in the median, to be in no doubt. Odometries that
slip a lot stay below; wrong axes are off by 1.4 and more about the axis that they exchange."""
FITTING_ERROR = 0.35
"""Share of a turn by which another convention may be off to be named. Right ones are off by 0.3 at
most, with an odometry and a depth that are poor; wrong ones by 0.49 at least, on the same data."""
MUCH_BETTER = 2.0
"""A convention that fits this much worse than the best one is not named beside it."""
STILL = 0.1
"""Share of the motion by tracking below which odometry does not move at all."""
MAX_UNIT = 5.0
"""Factor between the lengths of motions from which the unit of odometry is in doubt. Units differ
by 10 and more; where the camera hardly moves, a phone's depth alone may be off by 4."""

DESCRIPTIONS = {
    "ros": "axes x forward, y left, z up, as of ROS's base_link (odometry.options.convention=ros "
    "for recorded poses)",
    "opengl": "axes x right, y up, z back, as of OpenGL's camera "
    "(odometry.options.convention=opengl for recorded poses)",
    "inverse": "poses from the world to the camera (odometry.options.world_to_camera=true for "
    "recorded poses), or with quaternions in another order than x y z w",
    "turned": "axes that are turned by {degrees:.0f} degrees, or mirrored",
}
NOTHING_FITS = (
    "no other axes fit either, so that it slips, or its times are not those of the depth images, "
    "or its quaternions are not in the order x y z w"
)


class OdometryCheck:
    """Tracks frames as ``LoopCloser`` does, but makes no map, to compare odometry with depth."""

    def __init__(self, config: Config) -> None:
        self._tracker = Tracker(config.tracking, seed=config.seed)
        self._selector = KeyframeSelector(config.keyframes)
        self._segment: int | None = None  # of the newest keyframe
        self._frames: list[FramePose] = []

    def add(self, frame: DepthFrame, T_odom_camera: Pose) -> None:
        """Track a frame, given its pose (4, 4) by odometry."""
        track = self._tracker.track(frame, T_odom_camera)
        index, T = len(self._frames), track.T_odom_camera
        segment = LOST if track.is_lost else track.segment
        self._frames.append(FramePose(frame.stamp_s, T_odom_camera, T, segment))
        if track.is_lost:
            return
        if self._segment != segment:
            self._selector.reset()
        if self._selector.select(index, T, inlier_ratio=track.inlier_ratio):
            self._tracker.keep()
            self._segment = segment

    def doubts(self) -> list[str]:
        """Return what is implausible about odometry; see ``find_odometry_doubts``."""
        return find_odometry_doubts(self._frames)


def find_odometry_doubts(frames: Sequence[FramePose]) -> list[str]:
    """Return sentences on what is implausible about odometry, beside what depth shows.

    Parameters
    ----------
    frames
        The processed frames in order, with their poses from odometry and by tracking.
    """
    motions = _measure(frames)
    if len(motions) < MIN_MOTIONS:
        return []
    if _is_still(motions):
        return ["odometry hardly moves while depth shows that the camera does"]
    return [*_doubt_unit(motions), *_doubt_convention(motions)]


def _measure(frames: Sequence[FramePose]) -> Array:
    """Return motions (N, 3, 4, 4): by tracking, by odometry, and by odometry's inverse poses."""
    motions, start = [], 0
    for end, frame in enumerate(frames):
        first = frames[start]
        if LOST in (first.segment, frame.segment) or first.segment != frame.segment:
            start = end
            continue
        tracked = se3.inverse(first.T_odom_camera) @ frame.T_odom_camera
        if _turn(tracked) < MIN_TURN_RAD and np.linalg.norm(tracked[:3, 3]) < MIN_SHIFT_M:
            continue
        if end - start <= MAX_FRAMES:
            by_odometry = se3.inverse(first.T_odom_raw) @ frame.T_odom_raw
            by_inverse = first.T_odom_raw @ se3.inverse(frame.T_odom_raw)
            motions.append(np.stack([tracked, by_odometry, by_inverse]))
        start = end
    return np.array(motions).reshape(-1, 3, 4, 4)


def _turn(T: Array) -> float:
    return float(se3.rotation_angle(T))


def _is_still(motions: Array) -> bool:
    """Return whether odometry neither turns nor shifts where tracking does."""
    sizes = np.stack(
        [se3.rotation_angle(motions[:, :2]), np.linalg.norm(motions[:, :2, :3, 3], axis=2)]
    )
    tracked, by_odometry = np.median(sizes, axis=1).T
    return bool((by_odometry < STILL * tracked).all())


def _doubt_unit(motions: Array) -> list[str]:
    """Doubt the unit of odometry if it moves by another order of magnitude than tracking."""
    tracked, by_odometry = np.linalg.norm(motions[:, :2, :3, 3], axis=2).T
    moves = tracked >= MIN_SHIFT_M / 2
    if moves.sum() < MIN_MOTIONS:
        return []
    factor = float(np.median(by_odometry[moves] / tracked[moves]))
    if 1.0 / MAX_UNIT <= factor <= MAX_UNIT:
        return []
    return [
        f"odometry moves {factor:.3g} times as far as depth shows, in the median of {moves.sum()} "
        "motions: its unit of length is probably not the metre, or that of depth is another"
    ]


def _doubt_convention(motions: Array) -> list[str]:
    """Doubt the axes of odometry if it turns about other ones than tracking; name what fits."""
    turns = Rotation.from_matrix(motions[..., :3, :3].reshape(-1, 3, 3)).as_rotvec()
    tracked, by_odometry, by_inverse = turns.reshape(-1, 3, 3).transpose(1, 0, 2)
    turned = np.linalg.norm(tracked, axis=1) >= MIN_TURN_RAD / 2
    if turned.sum() < MIN_MOTIONS:
        return []
    tracked, by_odometry, by_inverse = tracked[turned], by_odometry[turned], by_inverse[turned]
    error = _error(tracked, by_odometry)
    if error <= MAX_ERROR:
        return []
    turned_by = _best_rotation(tracked, by_odometry)
    errors = {name: _error(tracked, by_odometry @ AXES[name]) for name in ("ros", "opengl")}
    errors["inverse"] = _error(tracked, by_inverse @ _best_rotation(tracked, by_inverse).T)
    if min(errors["ros"], errors["opengl"]) > FITTING_ERROR:  # of which each is a turn itself
        errors["turned"] = _error(tracked, by_odometry @ turned_by.T)
    best = min(errors.values())
    likely = NOTHING_FITS
    if best <= FITTING_ERROR:
        degrees = np.degrees(se3.rotation_angle(turned_by))
        likely = "it would fit as " + ", or as ".join(
            DESCRIPTIONS[name].format(degrees=degrees)
            for name, off in sorted(errors.items(), key=lambda item: round(item[1], 2))
            if off <= min(FITTING_ERROR, MUCH_BETTER * best)
        )
    return [
        f"odometry turns otherwise than depth shows, by {error:.0%} of the turn in the median of "
        f"{turned.sum()} turns: {likely}"
    ]


def _error(tracked: Array, turns: Array) -> float:
    """Return the median difference of turns (N, 3), as a share of the median turn."""
    off = np.linalg.norm(tracked - turns, axis=1)
    return float(np.median(off) / np.median(np.linalg.norm(tracked, axis=1)))


def _best_rotation(tracked: Array, turns: Array) -> Array:
    """Return a rotation (3, 3) that takes turns (N, 3) to those of tracking (Kabsch).

    It is one of many where all turns are about the same axis, as those of a robot on the floor.
    """
    R, weights = np.eye(3), np.ones(len(turns))
    for _ in range(3):  # some frames may have followed odometry
        R = se3.nearest_rotation((weights[:, None] * tracked).T @ turns)
        off = np.linalg.norm(tracked - turns @ R.T, axis=1)
        weights = 1.0 / (1.0 + np.square(off / max(float(np.median(off)), 1e-6)))
    return np.asarray(R)
