"""Loop candidates by bags of words, as in the paper (section 3.4).

The score ``s(i, N)`` of keyframe N and an older keyframe i is divided by the score against the
keyframe about one second before N, which shows how high scores are in this place:
``eta(i, N) = s(i, N) / s(N - tau, N)``.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.bof import InvertedIndex
from slam_bof.loops.candidate_checks import (
    CandidateChecks,
    LoopCounts,
    RankedCandidates,
    find_maxima,
)
from slam_bof.loops.params import LoopParams
from slam_bof.types import (
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    Keyframe,
    Loop,
    SavedConstellation,
)

__all__ = ["BagLoopDetector"]


class BagLoopDetector:
    """Finds loop candidates by eta of bags of words; see ``LoopDetector``.

    All keyframes stay in the search, as in the paper.

    Parameters
    ----------
    params
        Parameters of the search.
    n_words
        Number of words of the vocabulary.
    """

    compare = None
    newest = None

    def __init__(self, params: LoopParams, n_words: int) -> None:
        self._params = params
        self._index = InvertedIndex(n_words)
        self._checks = CandidateChecks(params)
        self._stamps_s: list[float] = []  # of this session
        self._n_before = 0  # number of keyframes of earlier sessions

    @property
    def counts(self) -> LoopCounts:
        """Numbers of keyframes of this session by the stage that their search reached."""
        return self._checks.counts

    def find(self, keyframe: Keyframe, frame: DepthFrame) -> RankedCandidates:
        """Return up to ``top_k`` maxima of eta, and store the keyframe."""
        n_older = self._checks.n_older(keyframe)
        ranked = self._rank(keyframe, n_older)
        self._store(keyframe)
        return RankedCandidates(self._checks.check(keyframe, ranked, n_older))

    def remember(
        self,
        keyframe: Keyframe,
        frame: DepthFrame,
        candidates: Sequence[Candidate],
        constellation: SavedConstellation | None = None,
    ) -> None:
        """Store a keyframe with the candidates that were found for it."""
        self._store(keyframe)
        self._checks.remember(keyframe, candidates)

    def on_loops_accepted(self, loops: Sequence[Loop]) -> None:
        """Do nothing: the paper searches all keyframes."""

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Forget the scene labels of keyframes; their bags stay."""
        self._checks.remove(keyframe_ids)

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Normalise by the keyframes of the new session alone."""
        self._n_before += len(self._stamps_s)
        self._stamps_s.clear()
        self._checks.begin_session()

    def state(self) -> dict[str, Any]:
        """Return the counts, as JSON values; keyframes contain everything else."""
        return self._checks.state() | {"ranking": None}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the counts."""
        self._checks.restore(state)

    def _rank(self, keyframe: Keyframe, n_older: int) -> list[Candidate]:
        """Return the maxima of eta, no two close to each other, as candidates."""
        if not (n_older and self._stamps_s):
            return []
        p, scores = self._params, self._index.scores(keyframe.bag)
        lag = np.abs(np.array(self._stamps_s) - (keyframe.stamp_s - p.normaliser_lag_s))
        normaliser = float(scores[self._n_before + lag.argmin()])
        ranked = []
        for best in find_maxima(scores[:n_older], p):
            score = float(scores[best])
            candidate = Candidate(
                keyframe.id,
                best,
                CandidateSource.BAG,
                score=score,
                normaliser=normaliser,
                eta=score / normaliser if normaliser > 0.0 else np.inf,
            )
            ranked.append(self._check_thresholds(candidate))
        return ranked

    def _check_thresholds(self, candidate: Candidate) -> Candidate:
        p = self._params
        if candidate.normaliser < p.min_normaliser:
            reason = f"normaliser {candidate.normaliser:.3f} below {p.min_normaliser:g}: not judged"
        elif candidate.eta < p.lower_threshold:
            reason = f"eta {candidate.eta:.3f} below {p.lower_threshold:g}"
        else:
            return candidate
        return replace(candidate, decision=Decision.REJECTED, reason=reason)

    def _store(self, keyframe: Keyframe) -> None:
        self._index.add(keyframe.bag)
        self._stamps_s.append(keyframe.stamp_s)
