"""Track the camera beside its odometry: correct small errors, and notice when it is lost.

Each frame is registered to the last keyframe, from where odometry has it, by some thousand points
of a small view. Other starts are tried where the two views agree less than they use to, or where
another pose nearby agrees better. Which directions the surfaces hold is found out by shifting the
pose (``geometry.observability``); the filter of ``odometry_fusion`` corrects odometry along these,
and leaves it alone along the others.

The track is lost where the views contradict odometry, surfaces of one stand where the other looks
through, and no pose nearby mends that: a quick turn, an odometry that restarted. Where the views
merely have little in common, odometry is believed. A lost track is found again at a frame that
agrees with the last keyframe after all; or a new segment starts once two frames in a row agree.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from slam_bof.geometry import (
    AlignmentParams,
    DepthView,
    Observability,
    PosePrior,
    ViewAligner,
    make_view,
    observe,
    se3,
    search_weak,
)
from slam_bof.tracking.odometry_fusion import OdometryFusion
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["Track", "Tracker", "TrackingParams"]

KEYFRAME, FRAME, BEFORE = 0, 1, 2
"""Views that the aligner holds: the last keyframe, the frame and, if asked, the one before it."""

MARGIN = 0.1
"""By so much must a pose by odometry agree better to be taken instead of the aligned one, which
is more exact than agreement can tell."""
REFERENCE_RATIO_RANGE = 0.5, 0.85
"""The first frame after the first keyframe sets the reference inlier ratio, between these ..."""
PRIOR_FLOOR = np.diag(np.square(np.repeat([0.002, 0.005], 3)))
"""Of where a frame should be, beyond what odometry errs by."""
MAX_REFERENCE_VIOLATION = 0.4
MAX_LEAP_M, MAX_LEAP_RAD = 0.7, 0.7
"""Odometry is not believed to move farther in a frame without anything seen that says so."""
FORGETTING = 0.1
"""... and each one since moves it, at this weight."""


class TrackingParams(Params):
    """What a frame must have in common with the keyframe, or with the frame before.

    Of the points that fall where the other view has a depth, the inlier ratio is the share that
    lies at that depth. A wrong pose in the same room may reach 0.7; what a right one has depends on
    the sensor (a structured-light camera 0.95, a stereo camera 0.8), so it is compared with its
    running mean, the reference.
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
    max_free_space_violation: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Largest share of compared points in front of what the other view sees, above "
        "its running mean; with more, and no better pose nearby, the track is lost.",
    )
    max_score_drop: float = Field(
        0.03,
        ge=0,
        description="Largest drop of the agreement score below its running mean before other "
        "poses are searched for.",
    )
    max_weak_sigma_m: float = Field(
        0.03,
        ge=0,
        description="Largest standard deviation of odometry along weakly held directions before "
        "other poses are searched for, in m.",
    )
    min_valid_pixel_ratio: float = Field(
        0.05,
        ge=0,
        le=1,
        description="Smallest share of pixels with a depth.",
    )


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a frame is.

    ``T_odom_camera`` (4, 4) is the odometry's pose, corrected by all that was registered so far;
    while ``is_lost`` it follows the odometry's motion, for want of better. ``segment`` counts how
    often the track started anew: what the poses of two segments say of each other is a guess.
    ``inlier_ratio`` is the share of points that the last keyframe sees too, NaN where not measured.
    ``covariance`` (6, 6) is of the pose since the last keyframe, rotation first, in rad and m;
    ``open_axes`` (6, k) are directions in the camera's frame, a turn in rad, then metres, that the
    surfaces in sight leave open.
    """

    T_odom_camera: Pose
    is_lost: bool
    segment: int
    inlier_ratio: float
    covariance: Array = field(default_factory=lambda: np.zeros((6, 6)))
    open_axes: Array = field(default_factory=lambda: np.empty((6, 0)))
    step_covariance: Array | None = None
    """The same, None where odometry is not tracked and nothing is known of its errors."""


class _Registration(NamedTuple):
    """A pose of the frame, and how far it agrees with a view."""

    T_odom_frame: Pose
    inlier_ratio: float
    visible_ratio: float
    free_space_violation: float
    held: Observability | None = None
    is_searched: bool = False


class _Found(NamedTuple):
    """Where a frame is, what the keyframe sees of it, and whether it follows the one before."""

    fit: _Registration
    inlier_ratio: float
    is_followed: bool


class Tracker:
    """Takes each frame with its odometry pose, and is told which ones become keyframes."""

    def __init__(
        self, params: TrackingParams | None = None, *, seed: int = 0, segment: int = 0
    ) -> None:
        self.params = params or TrackingParams()
        self.n_lost = 0
        self._aligner = ViewAligner(self.params.alignment, seed=seed)
        self._seed = seed
        self._segment = segment
        self._is_lost = False
        self._reference_inlier_ratio = float("nan")
        self._reference_score = float("nan")
        self._reference_violation = 0.0
        self._view: DepthView | None = None
        self._fusion = OdometryFusion()
        self._T_last = self._T_before = self._T_known = self._T_keyframe = np.eye(4)

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
        T_guess = self._fusion.predict(T_odom_camera, covariance)
        found = self._find(before, T_guess)
        is_lost = found is None
        if is_lost and not self._is_lost and len(self._aligner):
            self.n_lost += 1
        T, inlier_ratio, open_axes = T_guess, float("nan"), np.empty((6, 0))
        if found is not None:
            T, inlier_ratio = found.fit.T_odom_frame, found.inlier_ratio
            held = found.fit.held
            if held is not None:
                open_axes = held.open_axes_camera
            if found.is_followed and held is not None:
                T = self._fusion.fuse(T, held.information)
            elif not found.is_followed:
                T = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
                spread = None
                if held is not None:
                    spread = np.asarray(np.linalg.inv(held.information + np.eye(6)))
                self._fusion.restart(T_odom_camera, T, spread)
            self._T_known = T
        self._T_before, self._T_last, self._is_lost = self._T_last, T, is_lost
        covariance = self._fusion.covariance
        return Track(T, is_lost, self._segment, inlier_ratio, covariance, open_axes, covariance)

    def keep(self) -> None:
        """Make the last frame the keyframe that the next ones are registered to."""
        if self._view is not None or not self.params.enabled:
            self._T_keyframe = self._T_last
            self._fusion.change_reference()
        if self._view is not None:
            self._aligner.truncate(KEYFRAME)
            self._aligner.add(self._view)

    def state(self) -> dict[str, Any]:
        """Return what keyframes do not tell, as JSON has it."""
        reference, score = (
            None if np.isnan(x) else x
            for x in (self._reference_inlier_ratio, self._reference_score)
        )
        return {
            "n_lost": self.n_lost,
            "reference_inlier_ratio": reference,
            "reference_score": score,
            "reference_violation": self._reference_violation,
            "T_before": self._T_before.tolist(),
            "fusion": self._fusion.state(),
        }

    def restore(self, state: dict[str, Any], frame: DepthFrame, track: Track) -> None:
        """Go on from a keyframe: its frame, and where it was found to be."""
        self.n_lost = state["n_lost"]
        self._reference_inlier_ratio, self._reference_score = (
            float("nan") if x is None else x
            for x in (state["reference_inlier_ratio"], state["reference_score"])
        )
        self._reference_violation = state["reference_violation"]
        self._segment = track.segment
        if self.params.enabled:
            self._view = self._look(frame)
            self._is_lost = False
            self._T_last = self._T_known = track.T_odom_camera
            self._T_before = np.array(state["T_before"])
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
            return _Found(_Registration(T_guess, 1.0, 1.0, 0.0), 1.0, False)
        self._aligner.truncate(FRAME)
        self._aligner.add(self._view)
        tracked = self._register(KEYFRAME, self._T_keyframe, T_guess)
        inlier_ratio = tracked.inlier_ratio * tracked.visible_ratio
        if np.isnan(self._reference_inlier_ratio):
            self._reference_inlier_ratio = float(
                np.clip(tracked.inlier_ratio, *REFERENCE_RATIO_RANGE)
            )
            self._reference_violation = min(tracked.free_space_violation, MAX_REFERENCE_VIOLATION)
        if not self._is_lost and self._is_tracked(tracked):
            self._reference_inlier_ratio += FORGETTING * (
                tracked.inlier_ratio - self._reference_inlier_ratio
            )
            violation = tracked.free_space_violation
            self._reference_violation += FORGETTING * (violation - self._reference_violation)
            return _Found(tracked, inlier_ratio, True)
        from_before = None
        if before is not None:
            self._aligner.add(before)
            from_before = self._register(BEFORE, self._T_last, T_guess)
            if not self._is_lost and self._is_tracked(from_before):
                return _Found(from_before, inlier_ratio, False)
        searched = self._search(T_guess)
        if self._is_relocalised(searched):
            return _Found(searched, searched.inlier_ratio * searched.visible_ratio, False)
        if self._is_lost and from_before and self._is_relocalised(from_before):
            self._segment += 1
            return _Found(from_before, 0.0, False)
        if not self._is_lost and not self._is_contradicted(T_guess, before):
            return _Found(_Registration(T_guess, np.nan, np.nan, np.nan), float("nan"), True)
        return None

    def _is_tracked(self, fit: _Registration) -> bool:
        p = self.params
        drop = p.max_inlier_drop_relocalised if fit.is_searched else p.max_inlier_drop
        return (
            fit.visible_ratio >= p.min_visible_ratio
            and fit.inlier_ratio >= self._reference_inlier_ratio - drop
        )

    def _is_relocalised(self, fit: _Registration) -> bool:
        p = self.params
        return (
            fit.visible_ratio >= p.min_visible_ratio_relocalised
            and fit.inlier_ratio >= self._reference_inlier_ratio - p.max_inlier_drop_relocalised
        )

    def _is_contradicted(self, T_guess: Pose, before: DepthView | None) -> bool:
        """Tell whether either view that the frame can be compared with contradicts odometry.

        So does a leap out of what both see, which no camera makes from one frame to the next.
        """
        limit = self._reference_violation + self.params.max_free_space_violation
        views = [(KEYFRAME, self._T_keyframe)]
        if before is not None:
            views.append((BEFORE, self._T_last))
        fits = [self._evaluate(k, T, se3.inverse(T) @ T_guess) for k, T in views]
        if any(fit.free_space_violation > limit for fit in fits):
            return True
        step = se3.inverse(self._T_last) @ T_guess
        leaps = np.linalg.norm(step[:3, 3]) > MAX_LEAP_M or se3.rotation_angle(step) > MAX_LEAP_RAD
        return (
            bool(leaps) and max(fit.visible_ratio for fit in fits) < self.params.min_visible_ratio
        )

    def _register(self, view_id: int, T_odom_view: Pose, T_guess: Pose) -> _Registration:
        """Align the frame with a view from where odometry has it, or from elsewhere if in doubt."""
        p = self.params
        T_view_guess = se3.inverse(T_odom_view) @ T_guess
        T = self._aligner.refine(FRAME, np.array([view_id]), T_view_guess[None])[0]
        fit = self._evaluate(view_id, T_odom_view, T)
        if fit.inlier_ratio <= 1.0 - MARGIN:
            guessed = self._evaluate(view_id, T_odom_view, T_view_guess)
            if guessed.inlier_ratio > fit.inlier_ratio + MARGIN:
                fit, T = guessed, T_view_guess
        held = observe(self._aligner, FRAME, view_id, T)
        if held is None:
            return fit
        prior = PosePrior(T_view_guess, self._fusion.covariance + PRIOR_FLOOR)
        if (
            held.is_better_near
            or held.score < self._reference_score - p.max_score_drop
            or held.weak_sigma_m(prior.covariance) > p.max_weak_sigma_m
        ):
            starts = [held.best_shift] if held.is_better_near else []
            last, before = self._T_last, self._T_before
            for T_odom_start in (last @ se3.inverse(before) @ last, last):
                starts.append(se3.inverse(T_odom_view) @ T_odom_start)
            T_best, _, _ = search_weak(
                self._aligner, FRAME, view_id, T, np.array(starts), prior, seed=self._seed
            )  # fmt: skip
            if T_best is not T:
                T = T_best
                fit = self._evaluate(view_id, T_odom_view, T)._replace(is_searched=True)
                held = observe(self._aligner, FRAME, view_id, T) or held
        if view_id == KEYFRAME:
            mean = self._reference_score
            self._reference_score = (
                held.score if np.isnan(mean) else mean + FORGETTING * (held.score - mean)
            )
        return fit._replace(held=held)

    def _search(self, T_guess: Pose) -> _Registration:
        """Align it with the keyframe from poses about the guess, and about the last one known."""
        starts = se3.inverse(self._T_keyframe) @ np.stack([T_guess, self._T_known])
        (T_keyframe_frame,) = self._aligner.align(FRAME, np.array([KEYFRAME]), starts[None])
        return self._evaluate(KEYFRAME, self._T_keyframe, T_keyframe_frame)

    def _evaluate(self, view_id: int, T_odom_view: Pose, T_view_frame: Pose) -> _Registration:
        """Measure how far the frame agrees with a view at a pose."""
        found = self._aligner.agreement(FRAME, np.array([view_id]), T_view_frame[None])
        visible_ratio = float(found.visible_ratio[0])
        inlier_ratio, violation = (
            float(x[0]) / max(visible_ratio, 1e-9)
            for x in (found.inlier_ratio, found.free_space_violation)
        )
        return _Registration(
            T_odom_view @ T_view_frame, inlier_ratio, visible_ratio, 0.5 * violation
        )
