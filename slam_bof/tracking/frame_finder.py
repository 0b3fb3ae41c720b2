"""Find a frame in the last keyframe, or in the frame before it, by aligning small views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from slam_bof.geometry import (
    DepthView,
    ViewAligner,
    make_view,
    open_directions,
    se3,
    search_weak_directions,
)
from slam_bof.tracking.tracking_params import TrackingParams
from slam_bof.types import Array, DepthFrame, Pose

__all__ = ["NO_AXES", "Found", "FrameFinder", "RecentPoses"]

KEYFRAME, FRAME, BEFORE = 0, 1, 2
"""Views that the aligner holds: the last keyframe, the frame and, if asked, the one before it."""

MARGIN = 0.1
"""The pose by odometry must agree better by this much to be preferred to the aligned one, which is
more precise than agreement can tell."""
REFERENCE_RATIO_RANGE = 0.5, 0.85
"""The first frame after the first keyframe sets the usual inlier ratio, within these limits."""
FORGETTING = 0.1
"""Weight of each later frame in the usual inlier ratio, score and free-space violation."""
NO_AXES: Array = np.empty((6, 0))
NO_INFORMATION: Array = np.zeros((6, 6))


@dataclass(frozen=True, slots=True, eq=False)
class RecentPoses:
    """Where the camera was, ``T_odom_camera`` (4, 4) each."""

    T_keyframe: Pose
    """At the last keyframe."""
    T_last: Pose
    """At the last frame."""
    T_before: Pose
    """At the frame before the last one."""
    T_known: Pose
    """At the last frame that was not lost."""


class _Registration(NamedTuple):
    """A pose of the frame, and how far it agrees with a view."""

    view_id: int
    T_view_frame: Pose
    T_odom_frame: Pose
    agreement: float
    """Share of inliers among the points that can be compared."""
    visible_ratio: float
    """Share of the points that can be compared."""
    free_space_violation: float
    open_axes: Array = NO_AXES
    """Tangents (6, k) of the pose along which the surfaces hold nothing."""
    information: Array = NO_INFORMATION
    """(6, 6) of the tangent of the pose, zero along open axes."""


class Found(NamedTuple):
    """Where a frame is, and what the keyframe sees of it."""

    T_odom_camera: Pose | None
    """None if only odometry tells."""
    inlier_ratio: float
    """Share of points that the keyframe sees too, NaN where not measured."""
    is_followed: bool
    """Whether it follows the frame before, without a jump."""
    open_axes: Array = NO_AXES
    """Tangents (6, k) of the pose along which the surfaces hold nothing."""
    information: Array = NO_INFORMATION
    """(6, 6) of the tangent of the pose, zero along open axes."""
    begins_segment: bool = False
    """Whether it agrees with the frame before, though both are lost to the keyframe."""


class FrameFinder:
    """Holds the views of the last keyframe and frame, and finds the next frame in them."""

    def __init__(self, params: TrackingParams, *, seed: int = 0) -> None:
        self.params = params
        self._seed = seed
        self._aligner = ViewAligner(params.alignment, seed=seed)
        self._view: DepthView | None = None  # of the last frame
        self._before: DepthView | None = None
        self._is_repeated = False  # the same image again, as some drivers give it
        self._reference_inlier_ratio = float("nan")
        self._reference_score = float("nan")
        self._reference_violation = 0.0

    @property
    def sees_enough(self) -> bool:
        """Whether the last frame showed enough to be found."""
        return self._view is not None

    def keep(self) -> bool:
        """Make the last frame the keyframe in which the next ones are found, if it shows enough."""
        if self._view is None:
            return False
        self._aligner.truncate(KEYFRAME)
        self._aligner.add(self._view)
        return True

    def look(self, frame: DepthFrame) -> None:
        """Take the next frame."""
        view = make_view(frame)
        n_visible = np.count_nonzero(view.depth_m)
        sees_enough = n_visible >= self.params.min_valid_pixel_ratio * view.depth_m.size
        self._is_repeated = self._view is not None and np.array_equal(
            view.depth_m, self._view.depth_m
        )
        self._before, self._view = self._view, view if sees_enough else None

    def find(
        self, T_guess: Pose, recent: RecentPoses, *, is_lost: bool, leaps: bool
    ) -> Found | None:
        """Return where the frame is, None if it is lost.

        Parameters
        ----------
        T_guess
            ``T_odom_camera`` (4, 4) by odometry.
        recent
            Where the camera was.
        is_lost
            Whether the frame before is lost.
        leaps
            Whether odometry moved too far to be believed unseen.
        """
        if self._view is None:
            return None
        if len(self._aligner) == 0:
            return Found(T_guess, 1.0, False)
        self._aligner.truncate(FRAME)
        self._aligner.add(self._view)
        followed = self._follow(KEYFRAME, recent.T_keyframe, T_guess, recent)
        inlier_ratio = followed.agreement * followed.visible_ratio
        if np.isnan(self._reference_inlier_ratio):
            self._reference_inlier_ratio = float(
                np.clip(followed.agreement, *REFERENCE_RATIO_RANGE)
            )
        # Where odometry leaps, the pose was found by a search.
        agrees = self._is_good if leaps else self._is_usual
        if not is_lost and agrees(followed):
            self._learn(followed)
            return Found(
                followed.T_odom_frame,
                inlier_ratio,
                is_followed=True,
                open_axes=followed.open_axes,
                information=followed.information,
            )
        from_before = None
        if self._before is not None:
            self._aligner.add(self._before)
            from_before = self._follow(BEFORE, recent.T_last, T_guess, recent)
            if not is_lost and agrees(from_before):
                return Found(from_before.T_odom_frame, inlier_ratio, False)
        searched = self._search(T_guess, recent)
        if self._is_good(searched):
            return Found(searched.T_odom_frame, searched.agreement * searched.visible_ratio, False)
        may_begin = is_lost and not self._is_repeated
        if may_begin and from_before and self._is_good(from_before):
            return Found(from_before.T_odom_frame, 0.0, False, begins_segment=True)
        if not is_lost and not self._is_contradicted(T_guess, recent, leaps=leaps):
            return Found(None, float("nan"), True)
        return None

    def state(self) -> dict[str, Any]:
        """Return what is usual, as JSON has it."""
        ratio, score = self._reference_inlier_ratio, self._reference_score
        return {
            "usual": None if np.isnan(ratio) else ratio,
            "usual_score": None if np.isnan(score) else score,
            "usual_violation": self._reference_violation,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Go on with what was usual."""
        # Maps that were saved before scores were measured do not have them.
        ratio, score = state["usual"], state.get("usual_score")
        self._reference_inlier_ratio = float("nan") if ratio is None else ratio
        self._reference_score = float("nan") if score is None else score
        self._reference_violation = state.get("usual_violation", 0.0)

    def _learn(self, registration: _Registration) -> None:
        """Learn what is usual."""
        self._reference_inlier_ratio += FORGETTING * (
            registration.agreement - self._reference_inlier_ratio
        )
        self._reference_violation += FORGETTING * (
            registration.free_space_violation - self._reference_violation
        )

    def _is_usual(self, registration: _Registration) -> bool:
        p = self.params
        return (
            registration.visible_ratio >= p.min_visible_ratio
            and registration.agreement >= self._reference_inlier_ratio - p.max_inlier_drop
        )

    def _is_good(self, registration: _Registration) -> bool:
        """Return whether it agrees well enough for a pose that had to be searched for."""
        p = self.params
        if (
            registration.visible_ratio < p.min_visible_ratio_relocalised
            or registration.agreement < self._reference_inlier_ratio - p.max_inlier_drop_relocalised
        ):
            return False
        # A wrong pose among walls at right angles may have the inliers, but is less exact.
        score = self._score(registration.view_id, registration.T_view_frame)
        return not score < self._reference_score - p.max_score_drop_relocalised

    def _is_contradicted(self, T_guess: Pose, recent: RecentPoses, *, leaps: bool) -> bool:
        """Return whether a view contradicts odometry, or odometry leaps out of what both see."""
        p = self.params
        views = [(KEYFRAME, recent.T_keyframe)]
        if self._before is not None:
            views.append((BEFORE, recent.T_last))
        at_guess = [self._evaluate(k, T, se3.inverse(T) @ T_guess) for k, T in views]
        limit = self._reference_violation + p.max_free_space_violation
        if any(registration.free_space_violation > limit for registration in at_guess):
            return True
        if any(registration.visible_ratio >= p.min_visible_ratio for registration in at_guess):
            return False
        return leaps

    def _follow(
        self, view_id: int, T_odom_view: Pose, T_guess: Pose, recent: RecentPoses
    ) -> _Registration:
        """Align the frame with a view from where odometry has it, or from elsewhere if in doubt."""
        T_view_guess = se3.inverse(T_odom_view) @ T_guess
        T = self._aligner.refine(FRAME, np.array([view_id]), T_view_guess[None])[0]
        registration = self._evaluate(view_id, T_odom_view, T)
        if registration.agreement <= 1.0 - MARGIN:
            guessed = self._evaluate(view_id, T_odom_view, T_view_guess)
            if guessed.agreement > registration.agreement + MARGIN:
                registration = guessed
        registration = self._improve(registration, T_odom_view, recent)
        T = registration.T_view_frame
        min_pairs = int(self.params.min_surface_ratio * self.params.alignment.n_points)
        found = open_directions(self._aligner, FRAME, view_id, T, min_pairs=min_pairs)
        if found is None:  # too few surfaces to hold anything
            return self._evaluate(view_id, T_odom_view, T_view_guess)._replace(open_axes=np.eye(6))
        directions, open_axes = found
        information = directions.pose_information(open_axes)
        if open_axes.shape[1] == 0:
            return registration._replace(information=information)
        T = directions.keep(open_axes, T, T_view_guess)
        tangents: Array = np.asarray(np.linalg.solve(directions.of_tangent(), open_axes))
        return self._evaluate(view_id, T_odom_view, T)._replace(
            open_axes=tangents, information=information
        )

    def _improve(
        self, registration: _Registration, T_odom_view: Pose, recent: RecentPoses
    ) -> _Registration:
        """Return a better pose if the views agree less than usual and there is one."""
        view_id, T_view_frame = registration.view_id, registration.T_view_frame
        score = self._score(view_id, T_view_frame)
        # Nothing is usual yet at first, so the comparison is false and a better pose is looked for.
        if not score >= self._reference_score - self.params.max_score_drop:
            T_view_last = se3.inverse(T_odom_view) @ recent.T_last
            step = se3.inverse(recent.T_before) @ recent.T_last
            starts = np.stack([T_view_last, T_view_last @ step])
            T_found = search_weak_directions(
                self._aligner, FRAME, view_id, T_view_frame, starts, seed=self._seed
            )
            if T_found is not T_view_frame:
                registration = self._evaluate(view_id, T_odom_view, T_found)
                score = self._score(view_id, T_found)
        if view_id == KEYFRAME:
            if np.isnan(self._reference_score):
                self._reference_score = score
            self._reference_score += FORGETTING * (score - self._reference_score)
        return registration

    def _score(self, view_id: int, T_view_frame: Pose) -> float:
        found = self._aligner.agreement_score(FRAME, np.array([view_id]), T_view_frame[None])
        return float(found.score[0])

    def _search(self, T_guess: Pose, recent: RecentPoses) -> _Registration:
        """Align it with the keyframe from poses about the guess, and about the last one known."""
        starts = se3.inverse(recent.T_keyframe) @ np.stack([T_guess, recent.T_known])
        (T_keyframe_frame,) = self._aligner.align(FRAME, np.array([KEYFRAME]), starts[None])
        return self._evaluate(KEYFRAME, recent.T_keyframe, T_keyframe_frame)

    def _evaluate(self, view_id: int, T_odom_view: Pose, T_view_frame: Pose) -> _Registration:
        """Measure how far the frame agrees with a view at a pose."""
        found = self._aligner.agreement(FRAME, np.array([view_id]), T_view_frame[None])
        inlier_ratio, visible_ratio = float(found.inlier_ratio[0]), float(found.visible_ratio[0])
        return _Registration(
            view_id=view_id,
            T_view_frame=T_view_frame,
            T_odom_frame=T_odom_view @ T_view_frame,
            agreement=inlier_ratio / max(visible_ratio, 1e-9),
            visible_ratio=visible_ratio,
            free_space_violation=float(found.free_space_violation[0]),
        )
