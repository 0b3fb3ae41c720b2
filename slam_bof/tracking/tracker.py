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

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from pydantic import Field

from slam_bof.geometry import AlignmentParams, View, ViewAligner, make_view, se3
from slam_bof.tracking.odometry_fusion import PoseFusion
from slam_bof.types import DepthFrame, Params, Pose

__all__ = ["Track", "Tracker", "TrackingParams"]

KEYFRAME, FRAME, BEFORE = 0, 1, 2
"""Views that the aligner holds: the last keyframe, the frame and, if asked, the one before it."""

MARGIN = 0.1
"""By so much must a pose by odometry agree better to be taken instead of the aligned one, which
is more exact than agreement can tell."""
USUAL = 0.5, 0.85
"""What agreement is usual is said by the first frame after the first keyframe, between these ..."""
FORGETTING = 0.1
"""... and by each one since, at this weight."""


class TrackingParams(Params):
    """What a frame must have in common with the keyframe, or with the frame before.

    Of the points that fall where the other view has a depth, agreement is the share that lies at
    that depth. A wrong pose in the same room may reach 0.7; what a right one has depends on the
    sensor (a structured-light camera 0.95, a stereo camera 0.8), so it is held against what is
    usual.
    """

    enabled: bool = Field(True, description="without, odometry is trusted as it is")
    alignment: AlignmentParams = AlignmentParams(
        n_points=1000, n_iterations=8, gates_m=(0.15, 0.03)
    )
    less: float = Field(0.2, ge=0, le=1, description="than usual, of a frame that odometry has")
    less_found: float = Field(0.1, ge=0, le=1, description="of one that had to be searched for")
    min_compared: float = Field(0.2, ge=0, le=1, description="share of points that can be told")
    min_compared_found: float = Field(0.4, ge=0, le=1)
    min_pixels: float = Field(0.05, ge=0, le=1, description="share of pixels with a depth")


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Where a frame is.

    ``T_odom_camera`` (4, 4) is the odometry's pose with all its slips so far mended; while
    ``is_lost`` it follows the odometry's motion, for want of better. ``segment`` counts how
    often the track began anew: what the poses of two segments say of each other is a guess.
    ``seen`` is the share of points that the last keyframe sees too, NaN where not measured.
    """

    T_odom_camera: Pose
    is_lost: bool
    segment: int
    seen: float


class _Fit(NamedTuple):
    """A pose of the frame, how far it agrees with a view, and by how much of either that is."""

    T_odom_frame: Pose
    agreement: float
    compared: float


class _Found(NamedTuple):
    """Where a frame is, what the keyframe sees of it, and whether it follows the one before."""

    T_odom_camera: Pose
    seen: float
    is_followed: bool


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
        self._usual = float("nan")
        self._view: View | None = None
        self._fusion = PoseFusion()
        self._T_last = self._T_known = self._T_keyframe = np.eye(4)

    def track(self, frame: DepthFrame, T_odom_camera: Pose) -> Track:
        """Say where the frame is, given its pose (4, 4) by odometry."""
        if not self.params.enabled:
            return Track(T_odom_camera, False, self._segment, float("nan"))
        before, self._view = self._view, self._look(frame)
        T_guess = self._fusion.predict(T_odom_camera)
        found = self._find(before, T_guess)
        is_lost = found is None
        if is_lost and not self._is_lost and len(self._aligner):
            self.n_lost += 1
        T, seen, is_followed = found or _Found(T_guess, float("nan"), False)
        if is_followed:
            T = self._fusion.fuse(T_odom_camera, T)
        T = se3.pose(se3.nearest_rotation(T[:3, :3]), T[:3, 3])
        if not is_followed:
            self._fusion.restart(T_odom_camera, T)
        if not is_lost:
            self._T_known = T
        self._T_last, self._is_lost = T, is_lost
        return Track(T, is_lost, self._segment, seen)

    def keep(self) -> None:
        """Make the last frame the keyframe that the next ones are aligned with."""
        if self._view is not None:
            self._aligner.truncate(KEYFRAME)
            self._aligner.add(self._view)
            self._T_keyframe = self._T_last
            self._fusion.change_reference()

    def state(self) -> dict[str, Any]:
        """Return what keyframes do not tell, as JSON has it."""
        usual = None if np.isnan(self._usual) else self._usual
        return {"n_lost": self.n_lost, "usual": usual, "fusion": self._fusion.state()}

    def restore(self, state: dict[str, Any], frame: DepthFrame, track: Track) -> None:
        """Go on from a keyframe: its frame, and where it was found to be."""
        self.n_lost = state["n_lost"]
        self._usual = float("nan") if state["usual"] is None else state["usual"]
        self._segment = track.segment
        if self.params.enabled:
            self._view = self._look(frame)
            self._is_lost = False
            self._T_last = self._T_known = track.T_odom_camera
            self.keep()
            self._fusion.restore(state["fusion"])

    def _look(self, frame: DepthFrame) -> View | None:
        """Return the frame's view if it shows enough."""
        view = make_view(frame)
        n_known = np.count_nonzero(view.depth_m)
        return view if n_known >= self.params.min_pixels * view.depth_m.size else None

    def _find(self, before: View | None, T_guess: Pose) -> _Found | None:
        """Return where the frame is; nothing if it is lost."""
        if self._view is None:
            return None
        if len(self._aligner) == 0:
            return _Found(T_guess, 1.0, False)
        self._aligner.truncate(FRAME)
        self._aligner.add(self._view)
        followed = self._follow(KEYFRAME, self._T_keyframe, T_guess)
        seen = followed.agreement * followed.compared
        if np.isnan(self._usual):
            self._usual = float(np.clip(followed.agreement, *USUAL))
        if not self._is_lost and self._is_usual(followed):
            self._usual += FORGETTING * (followed.agreement - self._usual)
            return _Found(followed.T_odom_frame, seen, True)
        from_before = None
        if before is not None:
            self._aligner.add(before)
            from_before = self._follow(BEFORE, self._T_last, T_guess)
            if not self._is_lost and self._is_usual(from_before):
                return _Found(from_before.T_odom_frame, seen, False)
        searched = self._search(T_guess)
        if self._is_good(searched):
            return _Found(searched.T_odom_frame, searched.agreement * searched.compared, False)
        if self._is_lost and from_before and self._is_good(from_before):
            self._segment += 1
            return _Found(from_before.T_odom_frame, 0.0, False)
        return None

    def _is_usual(self, fit: _Fit) -> bool:
        p = self.params
        return fit.compared >= p.min_compared and fit.agreement >= self._usual - p.less

    def _is_good(self, fit: _Fit) -> bool:
        p = self.params
        return fit.compared >= p.min_compared_found and fit.agreement >= self._usual - p.less_found

    def _follow(self, view_id: int, T_odom_view: Pose, T_guess: Pose) -> _Fit:
        """Align the frame with a view from where odometry has it."""
        T_view_guess = se3.inverse(T_odom_view) @ T_guess
        T_view_mended = self._aligner.refine(FRAME, np.array([view_id]), T_view_guess[None])[0]
        mended = self._fit(view_id, T_odom_view, T_view_mended)
        if mended.agreement > 1.0 - MARGIN:
            return mended
        guessed = self._fit(view_id, T_odom_view, T_view_guess)
        return guessed if guessed.agreement > mended.agreement + MARGIN else mended

    def _search(self, T_guess: Pose) -> _Fit:
        """Align it with the keyframe from poses about the guess, and about the last one known."""
        starts = se3.inverse(self._T_keyframe) @ np.stack([T_guess, self._T_known])
        (T_keyframe_frame,) = self._aligner.align(FRAME, np.array([KEYFRAME]), starts[None])
        return self._fit(KEYFRAME, self._T_keyframe, T_keyframe_frame)

    def _fit(self, view_id: int, T_odom_view: Pose, T_view_frame: Pose) -> _Fit:
        """Measure how far the frame agrees with a view at a pose."""
        found = self._aligner.agreement(FRAME, np.array([view_id]), T_view_frame[None])
        seen, compared = float(found.seen[0]), float(found.compared[0])
        return _Fit(T_odom_view @ T_view_frame, seen / max(compared, 1e-9), compared)
