"""Proposal of loops by bags of words, as in the paper, or by depth views."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.bof import InvertedIndex
from slam_bof.loops.params import LoopParams
from slam_bof.places import PlaceRecogniser
from slam_bof.types import (
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    Keyframe,
    Pose,
    SavedConstellation,
)

__all__ = ["BagRanking", "Found", "Ranking", "ViewRanking"]


@dataclass(frozen=True, slots=True)
class Found:
    """The candidates of a keyframe, best first.

    Rejected candidates have the reason. Open ones are verified by geometry; of accepted ones, which
    are above the upper threshold, geometry only measures the relative pose. ``guesses`` has the
    initial ``T_match_query`` by ``match_id`` of candidates that were aligned.
    """

    candidates: list[Candidate] = field(default_factory=list)
    guesses: Mapping[int, Pose] = field(default_factory=dict)


class Ranking(Protocol):
    """A method that ranks older keyframes by their similarity to a new one."""

    @property
    def newest(self) -> SavedConstellation | None:
        """The constellation of the keyframe stored last, None if the method uses none."""

    def rank(self, keyframe: Keyframe, frame: DepthFrame, n_older: int) -> Found:
        """Return the best of the first ``n_older`` keyframes, and store this one."""

    def remember(
        self, keyframe: Keyframe, frame: DepthFrame, saved: SavedConstellation | None = None
    ) -> None:
        """Store a keyframe without a search, as it was ``saved`` by ``newest``."""

    def deactivate(self) -> None:
        """Exclude the newest keyframe from later searches."""

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Remove keyframes for good."""

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for keyframes with another odometry frame and clock."""

    def state(self) -> Any:
        """Return the state that keyframes do not contain, as JSON values."""

    def restore(self, state: Any) -> None:
        """Restore a state, after its keyframes were stored."""


class BagRanking:
    """Ranks keyframes by eta of their bags, as in the paper."""

    newest = None

    def __init__(self, params: LoopParams, n_words: int) -> None:
        self._params = params
        self._index = InvertedIndex(n_words)
        self._stamps_s: list[float] = []
        self._n_before = 0

    def rank(self, keyframe: Keyframe, frame: DepthFrame, n_older: int) -> Found:
        """Return up to ``top_k`` maxima of eta, no two within ``max_index_difference``."""
        p = self._params
        scores = self._index.scores(keyframe.bag)
        found = Found()
        if n_older and self._stamps_s:
            lag = np.abs(np.array(self._stamps_s) - (keyframe.stamp_s - p.normaliser_lag_s))
            normaliser = float(scores[self._n_before + lag.argmin()])
            for best in _maxima(scores[:n_older], p):
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
                found.candidates.append(self._check_thresholds(candidate))
        self.remember(keyframe, frame)
        return found

    def remember(
        self, keyframe: Keyframe, frame: DepthFrame, saved: SavedConstellation | None = None
    ) -> None:
        """Store the bag of the keyframe."""
        self._index.add(keyframe.bag)
        self._stamps_s.append(keyframe.stamp_s)

    def deactivate(self) -> None:
        """Do nothing: the paper searches all keyframes."""

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Do nothing, as well."""

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Normalise by the keyframes of the new session alone."""
        self._n_before += len(self._stamps_s)
        self._stamps_s.clear()

    def state(self) -> Any:
        """Return None: keyframes contain everything."""

    def restore(self, state: Any) -> None:
        """Do nothing, as there is no other state."""

    def _check_thresholds(self, candidate: Candidate) -> Candidate:
        p = self._params
        if candidate.normaliser < p.min_normaliser:
            reason = f"normaliser {candidate.normaliser:.3f} below {p.min_normaliser:g}: not judged"
        elif candidate.eta < p.lower_threshold:
            reason = f"eta {candidate.eta:.3f} below {p.lower_threshold:g}"
        else:
            return candidate
        return replace(candidate, decision=Decision.REJECTED, reason=reason)


class ViewRanking:
    """Ranks keyframes by the score of the place recogniser after alignment."""

    def __init__(self, params: LoopParams, recogniser: PlaceRecogniser) -> None:
        self._params = params
        self._recogniser = recogniser

    def rank(self, keyframe: Keyframe, frame: DepthFrame, n_older: int) -> Found:
        """Return up to ``top_k`` maxima of the score, no two within ``max_index_difference``."""
        p = self._params
        self.remember(keyframe, frame)
        matches = {m.view_id: m for m in self._recogniser.recognise(keyframe.id, n_older)}
        scores = np.zeros(n_older)
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

    def remember(
        self, keyframe: Keyframe, frame: DepthFrame, saved: SavedConstellation | None = None
    ) -> None:
        """Store the view of the keyframe."""
        self._recogniser.add(frame, keyframe.T_odom_camera, saved)

    @property
    def newest(self) -> SavedConstellation | None:
        """The constellation of the keyframe stored last."""
        return self._recogniser.newest

    def deactivate(self) -> None:
        """Exclude the newest view from later searches."""
        self._recogniser.deactivate()

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Remove the views of keyframes."""
        self._recogniser.remove(keyframe_ids)

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for another direction of gravity, and follow no earlier matches."""
        self._recogniser.begin_session(gravity_odom)

    def state(self) -> Any:
        """Return the matches that are followed."""
        return self._recogniser.state()

    def restore(self, state: Any) -> None:
        """Restore the matches that are followed."""
        self._recogniser.restore(state)


def _maxima(scores: NDArray[np.floating], params: LoopParams) -> list[int]:
    """Return up to ``top_k`` ids with the highest scores above 0, none close to a better one."""
    left = scores.astype(np.float64)
    chosen: list[int] = []
    while len(chosen) < params.top_k and len(left) and left.max() > 0.0:
        best = int(left.argmax())
        chosen.append(best)
        apart = params.max_index_difference
        left[max(0, best - apart) : best + apart + 1] = 0.0
    return chosen
