"""Follow the camera beside its odometry: mend the odometry's slips, and notice when it is lost.

Each frame is aligned with the last keyframe, from where odometry has it, by some thousand points
of a small view. Where it does not agree with what the keyframe sees, nor with what the frame
before it saw, not even after a search about the place, the track is lost: a quick turn, a covered
lens, an odometry that was started anew. It is found again at a frame that agrees with the last
keyframe after all; or it starts anew once two frames in a row agree with each other.

While the track is followed, odometry keeps as much say as it deserves (``fusion``): there is one
that errs by less from frame to frame than an alignment.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from slam_bof.geometry import (
    AlignmentParams,
    DepthView,
    ViewAligner,
    make_view,
    open_directions,
    se3,
    search_weak_directions,
)
from slam_bof.tracking.odometry_fusion import OdometryFusion
from slam_bof.tracking.step_noise import StepNoise
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["Track", "Tracker", "TrackingParams"]

KEYFRAME, FRAME, BEFORE = 0, 1, 2
"""Views that the aligner holds: the last keyframe, the frame and, if asked, the one before it."""

MARGIN = 0.1
"""By so much must a pose by odometry agree better to be taken instead of the aligned one, which
is more exact than agreement can tell."""
REFERENCE_RATIO_RANGE = 0.5, 0.85
"""What agreement is usual is said by the first frame after the first keyframe, between these ..."""
FORGETTING = 0.1
"""... and by each one since, at this weight."""


import os
MAX_SCORE_DROP = 0.03
BELIEVE = bool(int(os.environ.get("BELIEVE", "1")))
MAX_VIOLATION = 0.1
SLIP_DROP = 0.05
MAX_LEAP_M, MAX_LEAP_RAD = 0.7, 0.7
WEIGH = bool(int(os.environ.get("WEIGH", "1")))
DBG = bool(int(os.environ.get("DBG", "0")))
SEARCH = os.environ.get("SEARCH", "drop")
OPEN = os.environ.get("OPEN", "guess")


class TrackingParams(Params):
    """What a frame must have in common with the keyframe, or with the frame before.

    Of the points that fall where the other view has a depth, agreement is the share that lies at
    that depth. A wrong pose in the same room may reach 0.7; what a right one has depends on the
    sensor (a structured-light camera 0.95, a stereo camera 0.8), so it is held against what is
    usual.
    """

    enabled: bool = Field(
        True,
        description="Whether frames are tracked; without, odometry is taken as it is.",
    )
    alignment: AlignmentParams = AlignmentParams(
        n_points=1000, n_iterations=8, gates_m=(0.15, 0.03)
    )
    max_inlier_drop: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Largest drop of the inlier ratio below its running mean at which a frame "
        "still counts as tracked.",
    )
    max_inlier_drop_relocalised: float = Field(
        0.1,
        ge=0,
        le=1,
        description="The same for a frame whose pose had to be searched for.",
    )
    min_visible_ratio: float = Field(
        0.2,
        ge=0,
        le=1,
        description="Smallest share of points that fall where the other view has a depth.",
    )
    min_visible_ratio_relocalised: float = Field(
        0.4,
        ge=0,
        le=1,
        description="The same for a frame whose pose had to be searched for.",
    )
    min_valid_pixel_ratio: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Smallest share of pixels with a depth.",
    )


NO_AXES = np.empty((6, 0))


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a frame is.

    ``T_odom_camera`` (4, 4) is the odometry's pose with all its slips so far mended; while
    ``is_lost`` it follows the odometry's motion, for want of better. ``segment`` counts how
    often the track began anew: what the poses of two segments say of each other is a guess.
    ``inlier_ratio`` is the share of points that the last keyframe sees too, NaN where not measured.
    """

    T_odom_camera: Pose
    is_lost: bool
    segment: int
    inlier_ratio: float
    open_axes: Array = field(default_factory=lambda: NO_AXES)
    step_covariance: Array | None = None


class _Registration(NamedTuple):
    """A pose of the frame, how far it agrees with a view, and by how much of either that is."""

    T_odom_frame: Pose
    agreement: float
    visible_ratio: float
    free_space_violation: float = 0.0
    open_axes: Array = NO_AXES


class _Found(NamedTuple):
    """Where a frame is, what the keyframe sees of it, and whether it follows the one before."""

    T_odom_camera: Pose | None
    inlier_ratio: float
    is_followed: bool
    open_axes: Array = NO_AXES


def of_odometry_along(axes: Array, covariance: Array) -> Array:
    """Return ``S`` such that ``axes @ S`` is the part of a covariance (6, 6) along axes (6, k)."""
    inverse = np.linalg.pinv(axes)
    return np.asarray(inverse @ covariance @ inverse.T @ axes.T)


class Tracker:
    """Takes each frame with its odometry pose, and is told which ones become keyframes."""

    def __init__(
        self, params: TrackingParams | None = None, *, seed: int = 0, segment: int = 0
    ) -> None:
        self.params = params or TrackingParams()
        self.n_lost = 0
        self._aligner = ViewAligner(self.params.alignment, seed=seed)
        self._segment = segment
        self._is_lost = False
        self._reference_inlier_ratio = float("nan")
        self._view: DepthView | None = None
        self._fusion = OdometryFusion()
        self._T_last = self._T_before = self._T_known = self._T_keyframe = np.eye(4)
        self._reference_score = float("nan")
        self._seed = seed
        self._reference_violation = 0.0
        self._noise = StepNoise()
        self._T_odometry = self._T_odometry_keyframe = np.eye(4)
        self._T_keyframe_aligned: Pose | None = None
        self._T_before_keyframe: Pose | None = None
        self._given_covariance: Array | None = None
        self._view_keyframe: DepthView | None = None
        self._view_before: DepthView | None = None

    def track(
        self, frame: DepthFrame, T_odom_camera: Pose, covariance: Array | None = None
    ) -> Track:
        """Say where the frame is, given its pose (4, 4) by odometry.

        ``covariance`` (6, 6) is odometry's of the step since the frame before, rotation first,
        along the camera's axes.
        """
        if not self.params.enabled:
            return Track(T_odom_camera, False, self._segment, float("nan"))
        before, self._view = self._view, self._look(frame)
        if covariance is not None:
            known = np.zeros((6, 6)) if self._given_covariance is None else self._given_covariance
            self._given_covariance = known + covariance
        T_guess = self._fusion.predict(T_odom_camera)
        found = self._find(before, T_guess)
        is_lost = found is None
        if is_lost and not self._is_lost and len(self._aligner):
            self.n_lost += 1
        T, inlier_ratio, is_followed, open_axes = found or _Found(T_guess, float("nan"), False)
        self._T_odometry = T_odom_camera
        self._T_keyframe_aligned = None
        step_covariance: Array | None = None
        if T is None:
            T = T_guess
            self._fusion.change_reference()
        elif is_followed:
            if open_axes.shape[1] == 0:
                self._T_keyframe_aligned = se3.inverse(self._T_keyframe) @ T
            T = self._fusion.fuse(T_odom_camera, T)
            T, step_covariance = self._weigh(T_odom_camera, T, open_axes)
        T = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
        if not is_followed:
            self._fusion.restart(T_odom_camera, T)
        if not is_lost:
            self._T_known = T
        self._T_before, self._T_last, self._is_lost = self._T_last, T, is_lost
        return Track(T, is_lost, self._segment, inlier_ratio, open_axes, step_covariance)

    def _weigh(self, T_odometry: Pose, T_fused: Pose, open_axes: Array) -> tuple[Pose, Array]:
        """Weigh odometry's step since the keyframe against the one by alignment.

        Returns the pose (4, 4) and the covariance (6, 6) of the step.
        """
        step = se3.inverse(self._T_odometry_keyframe) @ T_odometry
        T_by_odometry = self._T_keyframe @ step
        difference = se3.log(se3.inverse(T_by_odometry) @ T_fused)
        of_alignment, of_odometry = self._noise.of_alignment, self._noise.of_odometry
        if self._given_covariance is not None:
            of_odometry = self._given_covariance
        elif self._noise.is_slip(difference) and self._agrees_worse(T_by_odometry, T_fused):
            return T_fused, of_alignment + open_axes @ of_odometry_along(open_axes, of_odometry)
        if not WEIGH: return T_fused, of_alignment
        gain = of_odometry @ np.linalg.inv(of_odometry + of_alignment)
        T = T_by_odometry @ se3.exp(gain @ difference)
        self._fusion.carry(T @ se3.inverse(T_fused))
        return T, gain @ of_alignment + open_axes @ of_odometry_along(open_axes, of_odometry)

    def _agrees_worse(self, T_odom_frame: Pose, T_odom_other: Pose) -> bool:
        """Tell whether the keyframe agrees clearly worse with one pose than with another."""
        T = se3.inverse(self._T_keyframe) @ np.stack([T_odom_frame, T_odom_other])
        score = self._aligner.agreement_score(FRAME, np.array([KEYFRAME, KEYFRAME]), T).score
        return bool(score[0] < score[1] - SLIP_DROP)

    def _learn_step(self) -> None:
        """Learn what the step to the new keyframe tells, before it takes the old one's place."""
        T_keyframe_frame = self._T_keyframe_aligned
        if T_keyframe_frame is not None:
            step = se3.inverse(self._T_odometry_keyframe) @ self._T_odometry
            difference = se3.log(se3.inverse(step) @ T_keyframe_frame)
            closure = None
            if self._T_before_keyframe is not None and self._view_before is not None:
                self._aligner.truncate(BEFORE)
                self._aligner.add(self._view_before)
                expected = self._T_before_keyframe @ T_keyframe_frame
                (T,) = self._aligner.refine(FRAME, np.array([BEFORE]), expected[None])
                if self._is_usual(self._evaluate(BEFORE, np.eye(4), T)):
                    closure = se3.log(se3.inverse(expected) @ T)
            self._noise.learn(difference, closure)
            if DBG: print("step", np.round(1e3*difference[3:],1), None if closure is None else np.round(1e3*closure[3:],1), "rms mm", np.round(1e3*np.sqrt(self._noise._alignment[1]),1), np.round(1e3*np.sqrt(self._noise._difference[1]),1))
        self._T_before_keyframe = T_keyframe_frame

    def keep(self) -> None:
        """Make the last frame the keyframe that the next ones are aligned with."""
        if self._view is not None:
            if len(self._aligner):
                self._learn_step()
            self._view_before, self._view_keyframe = self._view_keyframe, self._view
            self._T_odometry_keyframe = self._T_odometry
            self._given_covariance = None
            self._aligner.truncate(KEYFRAME)
            self._aligner.add(self._view)
            self._T_keyframe = self._T_last
            self._fusion.change_reference()

    def state(self) -> dict[str, Any]:
        """Return what keyframes do not tell, as JSON has it."""
        reference = None if np.isnan(self._reference_inlier_ratio) else self._reference_inlier_ratio
        return {"n_lost": self.n_lost, "usual": reference, "fusion": self._fusion.state()}

    def restore(self, state: dict[str, Any], frame: DepthFrame, track: Track) -> None:
        """Go on from a keyframe: its frame, and where it was found to be."""
        self.n_lost = state["n_lost"]
        self._reference_inlier_ratio = float("nan") if state["usual"] is None else state["usual"]
        self._segment = track.segment
        if self.params.enabled:
            self._view = self._look(frame)
            self._is_lost = False
            self._T_last = self._T_known = track.T_odom_camera
            self.keep()
            self._fusion.restore(state["fusion"])

    def _look(self, frame: DepthFrame) -> DepthView | None:
        """Return the frame's view if it shows enough."""
        view = make_view(frame)
        n_visible = np.count_nonzero(view.depth_m)
        return view if n_visible >= self.params.min_valid_pixel_ratio * view.depth_m.size else None

    def _find(self, before: DepthView | None, T_guess: Pose) -> _Found | None:
        """Return where the frame is; nothing if it is lost."""
        if self._view is None:
            return None
        if len(self._aligner) == 0:
            return _Found(T_guess, 1.0, False)
        self._aligner.truncate(FRAME)
        self._aligner.add(self._view)
        followed = self._follow(KEYFRAME, self._T_keyframe, T_guess)
        inlier_ratio = followed.agreement * followed.visible_ratio
        if np.isnan(self._reference_inlier_ratio):
            self._reference_inlier_ratio = float(
                np.clip(followed.agreement, *REFERENCE_RATIO_RANGE)
            )
        if not self._is_lost and self._is_usual(followed):
            self._reference_violation += FORGETTING * (
                followed.free_space_violation - self._reference_violation
            )
            self._reference_inlier_ratio += FORGETTING * (
                followed.agreement - self._reference_inlier_ratio
            )
            return _Found(followed.T_odom_frame, inlier_ratio, True, followed.open_axes)
        from_before = None
        if before is not None:
            self._aligner.add(before)
            from_before = self._follow(BEFORE, self._T_last, T_guess)
            if not self._is_lost and self._is_usual(from_before):
                return _Found(from_before.T_odom_frame, inlier_ratio, False)
        searched = self._search(T_guess)
        if self._is_good(searched):
            return _Found(searched.T_odom_frame, searched.agreement * searched.visible_ratio, False)
        if self._is_lost and from_before and self._is_good(from_before):
            self._segment += 1
            return _Found(from_before.T_odom_frame, 0.0, False)
        if BELIEVE and not self._is_lost and not self._is_contradicted(T_guess, before):
            return _Found(None, float("nan"), True)
        return None

    def _is_contradicted(self, T_guess: Pose, before: DepthView | None) -> bool:
        """Tell whether either view that the frame can be compared with contradicts odometry.

        So does a leap out of what both see, which no camera makes from one frame to the next.
        """
        views = [(KEYFRAME, self._T_keyframe)]
        if before is not None:
            views.append((BEFORE, self._T_last))
        fits = [self._evaluate(k, T, se3.inverse(T) @ T_guess) for k, T in views]
        limit = self._reference_violation + MAX_VIOLATION
        if any(fit.free_space_violation > limit for fit in fits):
            return True
        step = se3.inverse(self._T_last) @ T_guess
        leaps = np.linalg.norm(step[:3, 3]) > MAX_LEAP_M or se3.rotation_angle(step) > MAX_LEAP_RAD
        is_seen = max(fit.visible_ratio for fit in fits) >= self.params.min_visible_ratio
        return bool(leaps) and not is_seen

    def _is_usual(self, registration: _Registration) -> bool:
        p = self.params
        return (
            registration.visible_ratio >= p.min_visible_ratio
            and registration.agreement >= self._reference_inlier_ratio - p.max_inlier_drop
        )

    def _is_good(self, registration: _Registration) -> bool:
        p = self.params
        return (
            registration.visible_ratio >= p.min_visible_ratio_relocalised
            and registration.agreement
            >= self._reference_inlier_ratio - p.max_inlier_drop_relocalised
        )

    def _follow(self, view_id: int, T_odom_view: Pose, T_guess: Pose) -> _Registration:
        """Align the frame with a view from where odometry has it."""
        T_view_guess = se3.inverse(T_odom_view) @ T_guess
        T_view_mended = self._aligner.refine(FRAME, np.array([view_id]), T_view_guess[None])[0]
        T = T_view_mended
        mended = self._evaluate(view_id, T_odom_view, T)
        if mended.agreement <= 1.0 - MARGIN:
            guessed = self._evaluate(view_id, T_odom_view, T_view_guess)
            if guessed.agreement > mended.agreement + MARGIN:
                T = T_view_guess
        match = np.array([view_id])
        score = float(self._aligner.agreement_score(FRAME, match, T[None]).score[0])
        if SEARCH == "always" or (SEARCH == "drop" and not score >= self._reference_score - MAX_SCORE_DROP):
            T_view_last = se3.inverse(T_odom_view) @ self._T_last
            starts = np.stack([T_view_last, T_view_last @ se3.inverse(self._T_before) @ self._T_last])
            T = search_weak_directions(self._aligner, FRAME, view_id, T, starts, seed=self._seed)
            score = float(self._aligner.agreement_score(FRAME, match, T[None]).score[0])
        if view_id == KEYFRAME:
            if np.isnan(self._reference_score):
                self._reference_score = score
            self._reference_score += FORGETTING * (score - self._reference_score)
        found = open_directions(self._aligner, FRAME, view_id, T) if OPEN != "none" else None
        open_axes = NO_AXES
        if found is not None and found[1].shape[1]:
            directions, open_axes = found
            T_keep = T_view_guess
            if OPEN == "cv":
                T_keep = se3.inverse(T_odom_view) @ self._T_last @ se3.inverse(self._T_before) @ self._T_last
            T = directions.keep(open_axes, T, T_keep)
        if open_axes.shape[1]:
            open_axes = np.linalg.inv(directions.of_tangent()) @ open_axes
        return self._evaluate(view_id, T_odom_view, T)._replace(open_axes=open_axes)

    def _search(self, T_guess: Pose) -> _Registration:
        """Align it with the keyframe from poses about the guess, and about the last one known."""
        starts = se3.inverse(self._T_keyframe) @ np.stack([T_guess, self._T_known])
        (T_keyframe_frame,) = self._aligner.align(FRAME, np.array([KEYFRAME]), starts[None])
        return self._evaluate(KEYFRAME, self._T_keyframe, T_keyframe_frame)

    def _evaluate(self, view_id: int, T_odom_view: Pose, T_view_frame: Pose) -> _Registration:
        """Measure how far the frame agrees with a view at a pose."""
        found = self._aligner.agreement(FRAME, np.array([view_id]), T_view_frame[None])
        inlier_ratio, visible_ratio = float(found.inlier_ratio[0]), float(found.visible_ratio[0])
        return _Registration(
            T_odom_view @ T_view_frame,
            inlier_ratio / max(visible_ratio, 1e-9),
            visible_ratio,
            float(found.free_space_violation[0]),
        )
