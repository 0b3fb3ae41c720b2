"""Loop candidates from bags of words (paper, section 3.4).

For keyframe N and an older keyframe i, the score ``s(i, N)`` of their bags is divided by the
score against the keyframe about one second before N, which tells what a good score is worth
here: ``eta(i, N) = s(i, N) / s(N - tau, N)``. The best are checked for contradicting scene
labels and for time consistency. What is left open goes to geometric verification.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.index import InvertedIndex
from slam_bof.types import Candidate, Keyframe, Params, Scene

__all__ = ["LoopDetector", "LoopParams", "scene_agreement"]


class LoopParams(Params):
    """The parameters of Table 10, and what the product adds to them."""

    lower_threshold: float = Field(0.4, ge=0, description="eta below it: discarded")
    normaliser_lag_s: float = Field(1.0, gt=0, description="tau, as a time")
    min_normaliser: float = Field(0.05, ge=0, description="below it the keyframe is not judged")
    tc: int = Field(3, ge=0, description="keyframes that the time consistency check runs over")
    tc_required: int = Field(1, ge=0, description="of which so many must agree")
    max_index_difference: int = Field(3, ge=0, description="keyframes apart that still agree")
    top_k: int = Field(3, gt=0, description="candidates a keyframe; 1 in the paper")
    min_age_s: float = Field(3.0, ge=0, description="younger keyframes are not loops")
    min_scene_agreement: float = Field(0.2, ge=0, le=1, description="below it labels contradict")


class LoopDetector:
    """Finds, for each keyframe in turn, the older ones that may show the same place."""

    def __init__(self, params: LoopParams, n_words: int) -> None:
        self.params = params
        self._index = InvertedIndex(n_words)
        self._keyframes: list[Keyframe] = []
        self._maxima: list[tuple[int, ...]] = []

    def find(self, keyframe: Keyframe) -> list[Candidate]:
        """Return the keyframe's candidates, best first, and remember the keyframe.

        Those that fail a check come back with ``decision`` "rejected" and the reason; those
        still open (``decision`` empty) are for geometric verification.
        """
        scores = self._index.scores(keyframe.bag)
        candidates = self._rank(keyframe, scores)
        candidates = [self._check(keyframe, candidate) for candidate in candidates]
        self._maxima.append(tuple(c.match_id for c in candidates))
        self._index.add(keyframe.bag)
        self._keyframes.append(keyframe)
        return candidates

    def _rank(self, keyframe: Keyframe, scores: NDArray[np.float32]) -> list[Candidate]:
        """Return up to ``top_k`` maxima of eta, no two within ``max_index_difference``."""
        p = self.params
        stamps_s = np.array([k.stamp_s for k in self._keyframes])
        n_old = int(np.searchsorted(stamps_s, keyframe.stamp_s - p.min_age_s, side="right"))
        if n_old == 0:
            return []
        reference = np.abs(stamps_s - (keyframe.stamp_s - p.normaliser_lag_s)).argmin()
        normaliser = float(scores[reference])
        eligible = scores[:n_old].astype(np.float64)
        ranked: list[Candidate] = []
        for _ in range(p.top_k):
            best = int(eligible.argmax())
            if eligible[best] <= 0.0:
                break
            score = float(eligible[best])
            eta = score / normaliser if normaliser > 0.0 else np.inf
            ranked.append(
                Candidate(keyframe.id, best, "bag", score=score, normaliser=normaliser, eta=eta)
            )
            apart = p.max_index_difference
            eligible[max(0, best - apart) : best + apart + 1] = 0.0
        return ranked

    def _check(self, keyframe: Keyframe, candidate: Candidate) -> Candidate:
        """Measure semantic agreement and time consistency, and reject what fails."""
        p = self.params
        candidate = replace(
            candidate,
            scene_agreement=scene_agreement(
                keyframe.scene, self._keyframes[candidate.match_id].scene
            ),
            n_consistent=self._count_consistent(candidate.match_id),
        )
        if candidate.normaliser < p.min_normaliser:
            reason = f"normaliser {candidate.normaliser:.3f} below {p.min_normaliser:g}: not judged"
        elif candidate.eta < p.lower_threshold:
            reason = f"eta {candidate.eta:.3f} below {p.lower_threshold:g}"
        elif candidate.scene_agreement < p.min_scene_agreement:
            reason = (
                f"scene labels contradict: agreement {candidate.scene_agreement:.2f} "
                f"below {p.min_scene_agreement:g}"
            )
        elif candidate.n_consistent < p.tc_required:
            reason = (
                f"time consistency: {candidate.n_consistent} of the last {p.tc} keyframes agree, "
                f"{p.tc_required} required"
            )
        else:
            return candidate
        return replace(candidate, decision="rejected", reason=reason)

    def _count_consistent(self, match_id: int) -> int:
        """Count the last ``tc`` keyframes that had a maximum near ``match_id``."""
        p = self.params
        recent = self._maxima[-p.tc :] if p.tc else []
        return sum(
            any(abs(other - match_id) <= p.max_index_difference for other in maxima)
            for maxima in recent
        )


def scene_agreement(a: Scene | None, b: Scene | None) -> float:
    """Return how well two label distributions agree, in [0, 1] (Bhattacharyya coefficient).

    Without a label on either side nothing contradicts: 1.
    """
    if a is None or b is None:
        return 1.0
    return float(np.sqrt(a.probabilities * b.probabilities).sum())
