"""Geometric verification of depth images: point-to-plane ICP with projective association.

A point's match is what the other image shows at the pixel it falls on (Blais and Levine 1995),
which takes no search tree. Without a guess, random poses about the same
view are tried first: that is for views found alike, not for any two.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from pydantic import Field

from slam_bof.geometry import (
    AlignmentParams,
    PosePrior,
    RegistrationQualityParams,
    ViewAligner,
    assess_registration,
    make_view,
    observe,
    search_weak,
)
from slam_bof.types import Array, DepthFrame, Pose, Verification

__all__ = ["ProjectiveParams", "ProjectiveVerifier"]


PRIOR = np.diag(np.square(np.repeat([0.02, 0.05], 3)))
"""Covariance, rad^2 and m^2, of the pose that an alignment ends with."""


class ProjectiveParams(RegistrationQualityParams):
    """What two views of the same surfaces must have in common."""

    alignment: AlignmentParams = AlignmentParams(
        n_points=3000, n_iterations=15, gates_m=(0.3, 0.03), n_final_iterations=4
    )
    max_free_space_violation: float = Field(
        0.15,
        ge=0,
        le=1,
        description="Largest share of points that may stand before what the other view sees.",
    )


class _Held(NamedTuple):
    """A pose (4, 4), its information (6, 6), and what is against it, in words."""

    T_match_query: Pose
    information: Array
    reason_against: str = ""


class ProjectiveVerifier:
    """Keeps small views, aligns two of them, and judges whether they show the same surfaces."""

    Params = ProjectiveParams

    def __init__(self, params: ProjectiveParams | None = None) -> None:
        self.params = params or ProjectiveParams()
        self._aligner = ViewAligner(self.params.alignment)

    def prepare(self, frame: DepthFrame, points_camera: Array) -> int:
        """Keep a small view of the frame; return its number."""
        self._aligner.add(make_view(frame))
        return len(self._aligner) - 1

    def forget(self, prepared: int) -> None:
        """Forget the view kept last.

        Raises
        ------
        ValueError
            If it is another one.
        """
        if prepared != len(self._aligner) - 1:
            raise ValueError(f"only view {len(self._aligner) - 1}, the last, can be forgotten")
        self._aligner.truncate(prepared)

    def verify(
        self,
        query: int,
        matches: Sequence[int],
        *,
        T_match_query: Array | None = None,
        seed: int = 0,
    ) -> list[Verification]:
        """Align ``query`` with each match from its guess or, without any, from standing still."""
        if len(matches) == 0:
            return []
        ids = np.array(matches)
        if T_match_query is None:
            T = self._aligner.align(query, ids, np.tile(np.eye(4), (len(ids), 1, 1, 1)))
        else:
            T = self._aligner.refine(query, ids, T_match_query)
        guesses = [None] * len(ids) if T_match_query is None else list(T_match_query)
        held = [
            self._hold(query, int(match), *poses)
            for match, *poses in zip(ids, T, guesses, strict=True)
        ]
        T = np.array([one.T_match_query for one in held])
        overlap, violation = self._aligner.inlier_ratio(query, ids, T)
        pairs = self._aligner.surface_pairs(query, ids, T)
        return [
            assess_registration(
                self.params,
                T[k],
                pairs[k].residuals_m,
                held[k].information,
                overlap=float(overlap[k]),
                guessed=T_match_query is not None,
                reason_against=self._reason_against(float(violation[k])) or held[k].reason_against,
            )
            for k in range(len(ids))
        ]

    def _hold(self, query: int, match: int, T: Pose, T_guess: Pose | None) -> _Held:
        """Return a pose that has been aligned as far as the surfaces hold it, and how firmly.

        Where a pose near a guessed one agrees better, it is searched for. One without a guess is
        rejected then: it is none that alignment ends with. Open directions stay as guessed.
        """
        held = observe(self._aligner, query, match, T)
        if held is None:
            return _Held(T, np.zeros((6, 6)))
        if T_guess is None:
            reason = "a pose nearby agrees better" if held.is_better_near else ""
            return _Held(T, held.information, reason)
        if held.is_better_near:
            start = held.best_shift[None]
            best, _, _ = search_weak(self._aligner, query, match, T, start, PosePrior(T, PRIOR))
            if best is not T:
                T, held = best, observe(self._aligner, query, match, best) or held
        return _Held(held.keep_open(T, T_guess), held.information)

    def _reason_against(self, free_space_violation: float) -> str:
        if free_space_violation <= self.params.max_free_space_violation:
            return ""
        return f"{free_space_violation:.2f} of the points stand before what the other sees"
