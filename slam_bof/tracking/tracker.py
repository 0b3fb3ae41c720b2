"""Track the camera alongside its odometry: correct small errors, and notice when it is lost.

Each frame is aligned with the last keyframe by about a thousand points of a small view, starting
from the pose by odometry. If the two views agree less than usual, other starts are tried as well.
Along directions that the surfaces leave open, the pose by odometry is kept.

If the frame agrees neither with the keyframe nor with the frame before it, not even after a search
around the pose, and what the views show contradicts odometry, the track is lost: after a quick
turn, behind a covered lens, or because odometry was restarted. If the views merely have little in
common, odometry is believed. A lost track resumes at a frame that agrees with the last keyframe
after all; or a new segment begins once two frames in a row agree with each other. Odometry that
is given with its covariance is believed while the camera sees nothing.

While the track is followed, odometry is weighted against alignment along each direction
(``odometry_fusion``), because from frame to frame it may be the more precise of the two.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from slam_bof.geometry import se3
from slam_bof.tracking.frame_finder import NO_AXES, Found, FrameFinder, RecentPoses
from slam_bof.tracking.odometry_fusion import OdometryFusion
from slam_bof.tracking.tracking_params import TrackingParams
from slam_bof.types import Array, DepthFrame, Pose

__all__ = ["Track", "Tracker"]

MAX_LEAP, LEAP = np.array([0.7, 0.7]), 5.0
"""Odometry that moves farther than this, in rad and m, and farther than usual by this factor, is
not believed where no view confirms it."""
FORGETTING = 0.1
"""Weight of each later step in the usual one."""


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a frame is.

    ``T_odom_camera`` (4, 4) is the odometry's pose, corrected by the alignment of all frames so
    far; while ``is_lost`` it follows the odometry's motion. ``segment`` counts how often the track
    was restarted: the relative pose of two segments is a guess.
    ``inlier_ratio`` is the share of points that the last keyframe sees too, NaN where not measured.
    ``open_axes`` (6, k) are tangents of the pose, rotation first, along which the surfaces hold
    nothing. ``step_covariance`` (6, 6) is that of the step since the last keyframe, rotation first,
    if the odometry's is known.
    """

    T_odom_camera: Pose
    is_lost: bool
    segment: int
    inlier_ratio: float
    open_axes: Array = field(default_factory=lambda: NO_AXES)
    step_covariance: Array | None = None


class Tracker:
    """Takes each frame with its odometry pose, and is told which ones become keyframes."""

    def __init__(
        self, params: TrackingParams | None = None, *, seed: int = 0, segment: int = 0
    ) -> None:
        self.params = params or TrackingParams()
        self.trusts_odometry = False
        """Whether odometry is known to be about as precise as alignment, so that it is believed
        where a frame cannot be aligned with the keyframe."""
        self.n_lost = 0
        self._finder = FrameFinder(self.params, seed=seed)
        self._fusion = OdometryFusion()
        self._segment = segment
        self._is_lost = False
        self._has_keyframe = False
        self._recent = RecentPoses(np.eye(4), np.eye(4), np.eye(4), np.eye(4))
        self._usual_step = np.zeros(2)  # rad and m, a running mean
        self._T_odometry = np.eye(4)

    def track(
        self, frame: DepthFrame, T_odom_camera: Pose, covariance: Array | None = None
    ) -> Track:
        """Say where the frame is, given its pose (4, 4) by odometry.

        ``covariance`` (6, 6) is that of the odometry's step since the frame before, rotation first,
        in rad^2 and m^2 along the axes of the camera.
        """
        step = _moved(se3.inverse(self._T_odometry) @ T_odom_camera)
        self._usual_step = self._usual_step + FORGETTING * (step - self._usual_step)
        self._T_odometry = T_odom_camera
        if not self.params.enabled:
            self._fusion.skip(T_odom_camera, covariance)
            return Track(
                T_odom_camera,
                False,
                self._segment,
                float("nan"),
                step_covariance=None if covariance is None else self._fusion.covariance,
            )
        self._finder.look(frame)
        T_guess = self._fusion.predict(T_odom_camera)
        leaps = self._leaps(T_guess)
        found = self._finder.find(T_guess, self._recent, is_lost=self._is_lost, leaps=leaps)
        can_trust = self.trusts_odometry and self._finder.sees_enough and not leaps
        if can_trust and not (found and found.is_followed):
            found = Found(None, float("nan"), True)
        elif covariance is not None and not self._finder.sees_enough and not leaps:
            # Nothing contradicts odometry that says itself how precise it is.
            found = Found(None, float("nan"), True, open_axes=np.eye(6))
        is_lost = found is None
        if is_lost and not self._is_lost and self._has_keyframe:
            self.n_lost += 1
        T, inlier_ratio, is_followed, open_axes, information, begins_segment = found or Found(
            T_guess, float("nan"), False
        )
        self._segment += begins_segment
        if T is None:
            T = T_guess
            self._fusion.skip(T_odom_camera, covariance)
        elif is_followed:
            T = self._fusion.fuse(T_odom_camera, T, information, covariance)
        T = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
        if not is_followed:
            # What odometry says of the step up to here does not hold any more.
            self._fusion.restart(T_odom_camera, T)
            covariance = None
        recent = self._recent
        self._recent = RecentPoses(
            recent.T_keyframe, T, recent.T_last, recent.T_known if is_lost else T
        )
        self._is_lost = is_lost
        return Track(
            T,
            is_lost,
            self._segment,
            inlier_ratio,
            open_axes,
            None if covariance is None else self._fusion.covariance,
        )

    def keep(self) -> None:
        """Make the last frame the keyframe that the next ones are aligned with."""
        self._fusion.change_keyframe()
        if self._finder.keep():
            self._has_keyframe = True
            self._recent = replace(self._recent, T_keyframe=self._recent.T_last)

    def state(self) -> dict[str, Any]:
        """Return what keyframes do not tell, as JSON has it."""
        return {
            "n_lost": self.n_lost,
            "T_before": self._recent.T_before.tolist(),
            "T_odometry": self._T_odometry.tolist(),
            "usual_step": self._usual_step.tolist(),
            "fusion": self._fusion.state(),
            **self._finder.state(),
        }

    def restore(self, state: dict[str, Any], frame: DepthFrame, track: Track) -> None:
        """Go on from a keyframe: its frame, and where it was found to be."""
        self.n_lost = state["n_lost"]
        self._segment = track.segment
        self._finder.restore(state)
        if self.params.enabled:
            self._finder.look(frame)
            self._is_lost = False
            T = track.T_odom_camera
            self._recent = RecentPoses(T, T, np.array(state.get("T_before", T)), T)
            self._T_odometry = np.array(state.get("T_odometry", T))
            self.keep()
            self._usual_step = np.array(state.get("usual_step", [0.0, 0.0]))
            self._fusion.restore(state["fusion"])

    def _leaps(self, T_guess: Pose) -> bool:
        """Return whether the step of odometry is too large, as steps go, to be believed unseen."""
        step = _moved(se3.inverse(self._recent.T_last) @ T_guess)
        return bool((step > np.maximum(MAX_LEAP, LEAP * self._usual_step)).any())


def _moved(step: Pose) -> Array:
    """Return by how much a step (4, 4) turns and moves, (2,) in rad and m."""
    return np.array([se3.rotation_angle(step), np.linalg.norm(step[:3, 3])])
