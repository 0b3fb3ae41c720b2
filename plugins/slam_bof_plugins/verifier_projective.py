"""Geometric verification of depth images: point-to-plane ICP with projective association.

A point's match is what the other image shows at the pixel it falls on (Blais and Levine 1995),
which needs no search tree. Without a guess, random poses around that of the match are tried first,
so the two views must be close to each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from pydantic import Field

from slam_bof.geometry import (
    AlignmentParams,
    RegistrationQualityParams,
    ViewAligner,
    assess_registration,
    make_view,
    open_directions,
)
from slam_bof.types import Array, DepthFrame, Verification

__all__ = ["ProjectiveParams", "ProjectiveVerifier"]


class ProjectiveParams(RegistrationQualityParams):
    """What two views of the same surfaces must have in common."""

    alignment: AlignmentParams = AlignmentParams(
        n_points=3000, n_iterations=15, gates_m=(0.3, 0.03), n_final_iterations=4
    )
    max_free_space_violation: float = Field(
        0.15,
        ge=0,
        le=1,
        description="Largest share of points that may lie in front of what the other view sees.",
    )
    min_agreement: float = Field(
        0.1,
        ge=-1,
        le=1,
        description="Smallest share of the points that fall where the other view has a depth that "
        "are inliers, less those in front of what it sees. Inliers and the former are the smaller "
        "number of both directions, the latter are those of both together.",
    )
    max_free_space_violation_global: float = Field(
        0.1,
        ge=0,
        le=2,
        description="Largest sum of that share in both directions where registration started "
        "without a guess, because a search over many poses finds some overlap by chance.",
    )


class ProjectiveVerifier:
    """Keeps small views, aligns two of them, and decides whether they show the same surfaces."""

    Params = ProjectiveParams

    def __init__(self, params: ProjectiveParams | None = None) -> None:
        self.params = params or ProjectiveParams()
        self._aligner = ViewAligner(self.params.alignment)

    def prepare(self, frame: DepthFrame, points_camera: Array) -> int:
        """Keep a small view of the frame; return its number."""
        self._aligner.add(make_view(frame))
        return len(self._aligner) - 1

    def forget(self, prepared: int) -> None:
        """Forget a view; its memory is used for the next one.

        Raises
        ------
        ValueError
            If it is not kept.
        """
        try:
            self._aligner.drop(prepared)
        except KeyError as error:
            raise ValueError(f"view {prepared} is not kept") from error
        if prepared == len(self._aligner) - 1:
            self._aligner.truncate(prepared)

    def verify(
        self,
        query: int,
        matches: Sequence[int],
        *,
        T_match_query: Array | None = None,
        seed: int = 0,
    ) -> list[Verification]:
        """Align ``query`` with each match from its guess or else from the same pose."""
        if len(matches) == 0:
            return []
        ids = np.array(matches)
        if T_match_query is None:
            T = self._aligner.align(query, ids, np.tile(np.eye(4), (len(ids), 1, 1, 1)))
        else:
            T = self._aligner.refine(query, ids, T_match_query)
        overlap, violation = self._aligner.inlier_ratio(query, ids, T)
        agreement = self._aligner.agreement(query, ids, T)
        balance = agreement.inlier_ratio - agreement.free_space_violation
        balance = balance / np.maximum(agreement.visible_ratio, 1e-9)
        if T_match_query is None:
            reasons = list(map(self._reason_against_found, agreement.free_space_violation))
        else:
            reasons = list(map(self._reason_against_guessed, violation, balance))
        pairs = self._aligner.surface_pairs(query, ids, T)
        verifications = [
            assess_registration(
                self.params,
                T[k],
                pairs[k],
                overlap=float(overlap[k]),
                guessed=T_match_query is not None,
                reason_against=reasons[k],
            )
            for k in range(len(ids))
        ]
        return [
            self._without_open_directions(query, match_id, verification)
            for match_id, verification in zip(matches, verifications, strict=True)
        ]

    def _reason_against_guessed(self, violation: float, balance: float) -> str:
        """Return what speaks against an alignment from a guess, or an empty string.

        ``violation`` is the share of the query's points that violate free space, ``balance`` the
        inliers less the points of either view that do, as a share of those that can be compared.
        """
        if violation > self.params.max_free_space_violation:
            return _before_what_is_seen(violation)
        if balance < self.params.min_agreement:
            return f"agreement {balance:.2f} below {self.params.min_agreement:g}"
        return ""

    def _reason_against_found(self, violation: float) -> str:
        """Return what speaks against an alignment without a guess, or an empty string.

        ``violation`` is the share of points of both views that violate free space.
        """
        if violation > self.params.max_free_space_violation_global:
            return _before_what_is_seen(violation)
        return ""

    def _without_open_directions(
        self, query: int, match: int, verification: Verification
    ) -> Verification:
        """Remove the apparent information along directions that the surfaces leave open."""
        if not verification.accepted:
            return verification
        found = open_directions(self._aligner, query, match, verification.T_match_query)
        if found is None or found[1].shape[1] == 0:
            return verification
        directions, axes = found
        information = directions.without(verification.information, axes)
        return replace(verification, information=information, n_open=axes.shape[1])


def _before_what_is_seen(share: float) -> str:
    return f"{share:.2f} of the points stand before what the other sees"
