"""Two ways to propose loops: by bags of words, the paper's, and by views, the product's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.bof import InvertedIndex
from slam_bof.loops.params import LoopParams
from slam_bof.places import PlaceRecogniser
from slam_bof.types import Candidate, CandidateSource, Decision, DepthFrame, Keyframe, Pose

__all__ = ["BagRanking", "Found", "Ranking", "ViewRanking"]


@dataclass(frozen=True, slots=True)
class Found:
    """The candidates of a keyframe, best first, and where recognition has the views already.

    Candidates that fail a check have ``decision`` "rejected" and the reason; those still open
    (``decision`` empty) are for geometric verification, and those above the upper threshold
    ("accepted") for their relative pose. ``guesses`` has ``T_match_query`` by ``match_id``, of
    those that were aligned.
    """

    candidates: list[Candidate] = field(default_factory=list)
    guesses: Mapping[int, Pose] = field(default_factory=dict)


class Ranking(Protocol):
    """A way to find what looks alike."""

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return the best of the older keyframes, and remember this one."""

    def remember(self, keyframe: Keyframe, frame: DepthFrame) -> None:
        """Take a keyframe without asking."""

    def deactivate(self) -> None:
        """Find others rather than the one ranked last."""

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Expect keyframes of another odometry, whose clock may start anew."""

    def state(self) -> Any:
        """Return what keyframes do not tell, as JSON has it."""

    def restore(self, state: Any) -> None:
        """Go on from there."""


class BagRanking:
    """The paper's: the maxima of eta."""

    def __init__(self, params: LoopParams, n_words: int) -> None:
        self._params = params
        self._index = InvertedIndex(n_words)
        self._stamps_s: list[float] = []
        self._n_before = 0

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return up to ``top_k`` maxima of eta, no two within ``max_index_difference``."""
        p = self._params
        scores = self._index.scores(keyframe.bag)
        found = Found()
        if older and self._stamps_s:
            lag = np.abs(np.array(self._stamps_s) - (keyframe.stamp_s - p.normaliser_lag_s))
            normaliser = float(scores[self._n_before + lag.argmin()])
            for best in _maxima(scores[: len(older)], p):
                score = float(scores[best])
                eta = score / normaliser if normaliser > 0.0 else np.inf
                candidate = Candidate(
                    keyframe.id,
                    best,
                    CandidateSource.BAG,
                    score=score,
                    normaliser=normaliser,
                    eta=eta,
                )
                found.candidates.append(self._judge(candidate))
        self.remember(keyframe, frame)
        return found

    def remember(self, keyframe: Keyframe, frame: DepthFrame) -> None:
        """Hold the keyframe's bag."""
        self._index.add(keyframe.bag)
        self._stamps_s.append(keyframe.stamp_s)

    def deactivate(self) -> None:
        """Do nothing: the paper's index holds all."""

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Normalise by the new session's keyframes alone."""
        self._n_before += len(self._stamps_s)
        self._stamps_s.clear()

    def state(self) -> Any:
        """Return nothing: keyframes tell all."""

    def restore(self, state: Any) -> None:
        """Do nothing."""

    def _judge(self, candidate: Candidate) -> Candidate:
        p = self._params
        if candidate.normaliser < p.min_normaliser:
            reason = f"normaliser {candidate.normaliser:.3f} below {p.min_normaliser:g}: not judged"
        elif candidate.eta < p.lower_threshold:
            reason = f"eta {candidate.eta:.3f} below {p.lower_threshold:g}"
        else:
            return candidate
        return replace(candidate, decision=Decision.REJECTED, reason=reason)


class ViewRanking:
    """The recogniser's: the maxima of what it ranks by, after aligning."""

    def __init__(self, params: LoopParams, recogniser: PlaceRecogniser) -> None:
        self._params = params
        self._recogniser = recogniser

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return up to ``top_k`` maxima of the score, no two within ``max_index_difference``."""
        p = self._params
        self.remember(keyframe, frame)
        matches = {m.view_id: m for m in self._recogniser.recognise(keyframe.id, len(older))}
        scores = np.zeros(len(older))
        scores[list(matches)] = [m.score for m in matches.values()]
        candidates = []
        for best in _maxima(scores, p):
            match = matches[best]
            candidate = Candidate(keyframe.id, best, CandidateSource.VIEW, score=match.score)
            if match.inlier_ratio < p.min_inlier_ratio:
                reason = (
                    f"both see {match.inlier_ratio:.2f} of the other, below {p.min_inlier_ratio:g}"
                )
                candidate = replace(candidate, decision=Decision.REJECTED, reason=reason)
            candidates.append(candidate)
        return Found(
            candidates, {c.match_id: matches[c.match_id].T_match_query for c in candidates}
        )

    def remember(self, keyframe: Keyframe, frame: DepthFrame) -> None:
        """Hold the keyframe's view."""
        self._recogniser.add(frame, keyframe.T_odom_camera)

    def deactivate(self) -> None:
        """Leave the view ranked last out of later searches."""
        self._recogniser.deactivate()

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Expect another direction of gravity; matches so far lead nowhere."""
        self._recogniser.begin_session(gravity_odom)

    def state(self) -> Any:
        """Return the matches that are followed."""
        return self._recogniser.state()

    def restore(self, state: Any) -> None:
        """Follow them again."""
        self._recogniser.restore(state)


def _maxima(scores: NDArray[np.floating], params: LoopParams) -> list[int]:
    """Return up to ``top_k`` ids of the highest scores above 0, none near one before it."""
    left = scores.astype(np.float64)
    chosen: list[int] = []
    while len(chosen) < params.top_k and len(left) and left.max() > 0.0:
        best = int(left.argmax())
        chosen.append(best)
        apart = params.max_index_difference
        left[max(0, best - apart) : best + apart + 1] = 0.0
    return chosen
