"""Track the camera alongside its odometry: correct small errors, and notice when it is lost.

Each frame is aligned with the last keyframe by about a thousand points of a small view, starting
from the pose by odometry. If the two views agree less than usual, other starts are tried as well.
Along directions that the surfaces leave open, the pose by odometry is kept.

If the frame agrees neither with the keyframe nor with the frame before it, not even after a search
around the pose, and what the views show contradicts odometry, the track is lost: after a quick
turn, behind a covered lens, or because odometry was restarted. If the views merely have little in
common, odometry is believed. A lost track resumes at a frame that agrees with the last keyframe
after all; or a new segment begins once two frames in a row agree with each other.

While the track is followed, odometry is weighted against alignment (``odometry_fusion``), because
from frame to frame it may be the more precise of the two.
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
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["Track", "Tracker", "TrackingParams"]

KEYFRAME, FRAME, BEFORE = 0, 1, 2
"""Views that the aligner holds: the last keyframe, the frame and, if asked, the one before it."""

MARGIN = 0.1
"""The pose by odometry must agree better by this much to be preferred to the aligned one, which is
more precise than agreement can tell."""
REFERENCE_RATIO_RANGE = 0.5, 0.85
"""The first frame after the first keyframe sets the usual inlier ratio, within these limits."""
FORGETTING = 0.1
"""Weight of each later frame in the usual inlier ratio, score and free-space violation."""
MAX_LEAP, LEAP = np.array([0.7, 0.7]), 5.0
"""Odometry that moves farther than this, in rad and m, and farther than usual by this factor, is
not believed where no view confirms it."""
OPEN_VARIANCE = 1e4
"""Variance of alignment along open directions."""
NO_AXES: Array = np.empty((6, 0))


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
    min_surface_ratio: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Smallest share of the points that must meet a surface of the other view; with "
        "fewer, an alignment may agree by chance, and the pose is that of odometry.",
    )
    max_score_drop: float = Field(
        0.02,
        ge=0,
        description="Largest drop of the agreement score below its running mean at which no other "
        "starts are tried.",
    )
    max_free_space_violation: float = Field(
        0.1,
        ge=0,
        le=1,
        description="Largest share of points in front of what the other view sees, above its "
        "running mean, at which odometry is believed although the views do not agree.",
    )
    alignment_sigma_rad: float = Field(
        0.002,
        gt=0,
        description="Standard deviation of the rotation by alignment, in rad, against which a "
        "covariance of odometry is weighted.",
    )
    alignment_sigma_m: float = Field(
        0.005,
        gt=0,
        description="The same for the translation, in m.",
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

    ``T_odom_camera`` (4, 4) is the odometry's pose with all its slips so far mended; while
    ``is_lost`` it follows the odometry's motion, for want of better. ``segment`` counts how
    often the track began anew: what the poses of two segments say of each other is a guess.
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


class _Registration(NamedTuple):
    """A pose of the frame, and how far it agrees with a view."""

    T_odom_frame: Pose
    agreement: float
    """Share of inliers among the points that can be compared."""
    visible_ratio: float
    """Share of the points that can be compared."""
    free_space_violation: float
    open_axes: Array = NO_AXES
    """Tangents (6, k) of the pose along which the surfaces hold nothing."""


class _Found(NamedTuple):
    """Where a frame is, what the keyframe sees of it, and whether it follows the one before."""

    T_odom_camera: Pose | None
    """None if only odometry tells."""
    inlier_ratio: float
    is_followed: bool
    open_axes: Array = NO_AXES


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
        self._usual_step = np.zeros(2)  # rad and m, a running mean
        self._aligner = ViewAligner(self.params.alignment, seed=seed)
        self._segment = segment
        self._is_lost = False
        self._seed = seed
        self._reference_inlier_ratio = float("nan")
        self._reference_score = float("nan")
        self._reference_violation = 0.0
        self._view: DepthView | None = None
        self._fusion = OdometryFusion()
        self._T_last = self._T_before = self._T_known = self._T_keyframe = np.eye(4)
        self._T_odometry = self._T_odometry_keyframe = np.eye(4)
        self._covariance: Array | None = None

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
        self._add_covariance(covariance)
        if not self.params.enabled:
            return Track(
                T_odom_camera,
                False,
                self._segment,
                float("nan"),
                step_covariance=self._covariance,
            )
        before, self._view = self._view, self._look(frame)
        T_guess = self._fusion.predict(T_odom_camera)
        found = self._find(before, T_guess)
        is_followed = found is not None and found.is_followed
        can_trust = self.trusts_odometry and self._view is not None and not self._leaps(T_guess)
        if can_trust and not is_followed:
            found = _Found(None, float("nan"), True)
        is_lost = found is None
        if is_lost and not self._is_lost and len(self._aligner):
            self.n_lost += 1
        T, inlier_ratio, is_followed, open_axes = found or _Found(T_guess, float("nan"), False)
        step_covariance = None
        if T is None:
            T, step_covariance = T_guess, self._covariance
            self._fusion.change_reference()
        elif is_followed:
            T = self._fusion.fuse(T_odom_camera, T)
            if self._covariance is not None:
                T, step_covariance = self._weigh(T_odom_camera, T, self._covariance, open_axes)
        T = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
        if not is_followed:
            self._fusion.restart(T_odom_camera, T)
            # What odometry says of the step up to here does not hold any more.
            self._T_odometry_keyframe = T_odom_camera @ se3.inverse(T) @ self._T_keyframe
        if not is_lost:
            self._T_known = T
        self._T_before, self._T_last, self._is_lost = self._T_last, T, is_lost
        return Track(T, is_lost, self._segment, inlier_ratio, open_axes, step_covariance)

    def keep(self) -> None:
        """Make the last frame the keyframe that the next ones are aligned with."""
        self._T_odometry_keyframe = self._T_odometry
        self._covariance = None if self._covariance is None else np.zeros((6, 6))
        if self._view is not None:
            self._aligner.truncate(KEYFRAME)
            self._aligner.add(self._view)
            self._T_keyframe = self._T_last
            self._fusion.change_reference()

    def state(self) -> dict[str, Any]:
        """Return what keyframes do not tell, as JSON has it."""
        reference = None if np.isnan(self._reference_inlier_ratio) else self._reference_inlier_ratio
        score = None if np.isnan(self._reference_score) else self._reference_score
        return {
            "n_lost": self.n_lost,
            "usual": reference,
            "usual_score": score,
            "usual_violation": self._reference_violation,
            "T_before": self._T_before.tolist(),
            "T_odometry": self._T_odometry.tolist(),
            "usual_step": self._usual_step.tolist(),
            "fusion": self._fusion.state(),
        }

    def restore(self, state: dict[str, Any], frame: DepthFrame, track: Track) -> None:
        """Go on from a keyframe: its frame, and where it was found to be."""
        self.n_lost = state["n_lost"]
        self._reference_inlier_ratio = float("nan") if state["usual"] is None else state["usual"]
        # Maps that were saved before scores were measured do not have them.
        score = state.get("usual_score")
        self._reference_score = float("nan") if score is None else score
        self._reference_violation = state.get("usual_violation", 0.0)
        self._segment = track.segment
        if self.params.enabled:
            self._view = self._look(frame)
            self._is_lost = False
            self._T_last = self._T_known = track.T_odom_camera
            self._T_before = np.array(state.get("T_before", track.T_odom_camera))
            self._T_odometry = np.array(state.get("T_odometry", track.T_odom_camera))
            self.keep()
            self._usual_step = np.array(state.get("usual_step", [0.0, 0.0]))
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
        # Where odometry leaps, the pose was found by a search.
        agrees = self._is_good if self._leaps(T_guess) else self._is_usual
        if not self._is_lost and agrees(followed):
            self._reference_inlier_ratio += FORGETTING * (
                followed.agreement - self._reference_inlier_ratio
            )
            self._reference_violation += FORGETTING * (
                followed.free_space_violation - self._reference_violation
            )
            return _Found(followed.T_odom_frame, inlier_ratio, True, followed.open_axes)
        from_before = None
        if before is not None:
            self._aligner.add(before)
            from_before = self._follow(BEFORE, self._T_last, T_guess)
            if not self._is_lost and agrees(from_before):
                return _Found(from_before.T_odom_frame, inlier_ratio, False)
        searched = self._search(T_guess)
        if self._is_good(searched):
            return _Found(searched.T_odom_frame, searched.agreement * searched.visible_ratio, False)
        if self._is_lost and from_before and self._is_good(from_before):
            self._segment += 1
            return _Found(from_before.T_odom_frame, 0.0, False)
        if not self._is_lost and not self._is_contradicted(T_guess, before):
            return _Found(None, float("nan"), True)
        return None

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

    def _is_contradicted(self, T_guess: Pose, before: DepthView | None) -> bool:
        """Return whether a view contradicts odometry, or odometry leaps out of what both see."""
        p = self.params
        views = [(KEYFRAME, self._T_keyframe)]
        if before is not None:
            views.append((BEFORE, self._T_last))
        at_guess = [self._evaluate(k, T, se3.inverse(T) @ T_guess) for k, T in views]
        limit = self._reference_violation + p.max_free_space_violation
        if any(registration.free_space_violation > limit for registration in at_guess):
            return True
        if any(registration.visible_ratio >= p.min_visible_ratio for registration in at_guess):
            return False
        return self._leaps(T_guess)

    def _leaps(self, T_guess: Pose) -> bool:
        """Return whether the step of odometry is too large, as steps go, to be believed unseen."""
        step = _moved(se3.inverse(self._T_last) @ T_guess)
        return bool((step > np.maximum(MAX_LEAP, LEAP * self._usual_step)).any())

    def _add_covariance(self, covariance: Array | None) -> None:
        """Add up the covariance of the odometry's steps since the last keyframe."""
        if covariance is not None:
            so_far = 0.0 if self._covariance is None else self._covariance
            self._covariance = so_far + covariance

    def _weigh(
        self, T_odometry: Pose, T_aligned: Pose, covariance: Array, open_axes: Array
    ) -> tuple[Pose, Array]:
        """Weigh the step since the keyframe by odometry, of known covariance, against alignment.

        Returns the pose (4, 4) and the covariance (6, 6) of the step.
        """
        sigma = np.repeat([self.params.alignment_sigma_rad, self.params.alignment_sigma_m], 3)
        step = se3.inverse(self._T_odometry_keyframe) @ T_odometry
        T_by_odometry = self._T_keyframe @ step
        of_alignment = np.diag(np.square(sigma)) + OPEN_VARIANCE * open_axes @ open_axes.T
        gain = covariance @ np.linalg.inv(covariance + of_alignment)
        difference = se3.log(se3.inverse(T_by_odometry) @ T_aligned)
        T = T_by_odometry @ se3.exp(gain @ difference)
        self._fusion.carry(T @ se3.inverse(T_aligned))
        return T, covariance - gain @ covariance

    def _follow(self, view_id: int, T_odom_view: Pose, T_guess: Pose) -> _Registration:
        """Align the frame with a view from where odometry has it, or from elsewhere if in doubt."""
        T_view_guess = se3.inverse(T_odom_view) @ T_guess
        T = self._aligner.refine(FRAME, np.array([view_id]), T_view_guess[None])[0]
        registration = self._evaluate(view_id, T_odom_view, T)
        if registration.agreement <= 1.0 - MARGIN:
            guessed = self._evaluate(view_id, T_odom_view, T_view_guess)
            if guessed.agreement > registration.agreement + MARGIN:
                registration, T = guessed, T_view_guess
        T_improved = self._improve(view_id, T_odom_view, T)
        if T_improved is not T:
            registration, T = self._evaluate(view_id, T_odom_view, T_improved), T_improved
        min_pairs = int(self.params.min_surface_ratio * self.params.alignment.n_points)
        found = open_directions(self._aligner, FRAME, view_id, T, min_pairs=min_pairs)
        if found is None:  # too few surfaces to hold anything
            return self._evaluate(view_id, T_odom_view, T_view_guess)._replace(open_axes=np.eye(6))
        directions, open_axes = found
        if open_axes.shape[1] == 0:
            return registration
        T = directions.keep(open_axes, T, T_view_guess)
        tangents: Array = np.asarray(np.linalg.solve(directions.of_tangent(), open_axes))
        return self._evaluate(view_id, T_odom_view, T)._replace(open_axes=tangents)

    def _improve(self, view_id: int, T_odom_view: Pose, T_view_frame: Pose) -> Pose:
        """Return a better pose if the views agree less than usual and there is one."""
        score = self._score(view_id, T_view_frame)
        # Nothing is usual yet at first, so the comparison is false and a better pose is looked for.
        if not score >= self._reference_score - self.params.max_score_drop:
            T_view_last = se3.inverse(T_odom_view) @ self._T_last
            step = se3.inverse(self._T_before) @ self._T_last
            starts = np.stack([T_view_last, T_view_last @ step])
            T_view_frame = search_weak_directions(
                self._aligner, FRAME, view_id, T_view_frame, starts, seed=self._seed
            )
            score = self._score(view_id, T_view_frame)
        if view_id == KEYFRAME:
            if np.isnan(self._reference_score):
                self._reference_score = score
            self._reference_score += FORGETTING * (score - self._reference_score)
        return T_view_frame

    def _score(self, view_id: int, T_view_frame: Pose) -> float:
        found = self._aligner.agreement_score(FRAME, np.array([view_id]), T_view_frame[None])
        return float(found.score[0])

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


def _moved(step: Pose) -> Array:
    """Return by how much a step (4, 4) turns and moves, (2,) in rad and m."""
    return np.array([se3.rotation_angle(step), np.linalg.norm(step[:3, 3])])
