"""Which keyframes are searched for loops, and what a candidate must pass before geometry.

Scene labels must not contradict each other, and earlier keyframes must have had candidates near the
same place (time consistency; paper, section 3.4).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray
from slam_bof.loops.params import LoopParams
from slam_bof.loops.spread_maxima import spread_maxima
from slam_bof.types import Candidate, CandidateSource, Decision, Keyframe, Pose, Scene

__all__ = ["CandidateChecks", "LoopCounts", "RankedCandidates", "find_maxima", "scene_agreement"]


@dataclass(frozen=True, slots=True)
class RankedCandidates:
    """The candidates of a keyframe, best first.

    Rejected candidates have the reason. Open ones are verified by geometry; of accepted ones, which
    are above the upper threshold, geometry only measures the relative pose. ``guesses`` has the
    initial ``T_match_query`` by ``match_id`` of candidates that were aligned.
    """

    candidates: list[Candidate] = field(default_factory=list)
    guesses: Mapping[int, Pose] = field(default_factory=dict)


@dataclass(slots=True)
class LoopCounts:
    """Numbers of keyframes by the stage that their loop search reached (paper, Table 10).

    Keyframes without older ones to search are not counted. Each other keyframe counts as one of
    ``candidate``, ``between``, ``discarded`` and ``unjudged``, by its candidate that came furthest.

    Parameters
    ----------
    candidate
        The candidate is above the upper threshold, or above the lower one if there is no upper.
    approved
        It also passes time consistency and the check of scene labels.
    between
        The candidate is between the two thresholds.
    discarded
        The candidate is below the lower threshold, or there is none.
    unjudged
        The normaliser is below its smallest value.
    """

    candidate: int = 0
    approved: int = 0
    between: int = 0
    discarded: int = 0
    unjudged: int = 0


class CandidateChecks:
    """Stores what the checks need of each keyframe, and checks the candidates of the next one.

    Attributes
    ----------
    counts
        Numbers of keyframes of this session by the stage that their search reached.
    """

    def __init__(self, params: LoopParams) -> None:
        self.counts = LoopCounts()
        self._params = params
        self._scenes: list[Scene | None] = []
        self._segments = GrowingArray((), np.int64)
        self._stamps_s = GrowingArray((), np.float64)
        self._maxima: deque[tuple[int, ...]] = deque(maxlen=params.tc)

    @property
    def newest_id(self) -> int:
        """The id of the keyframe stored last."""
        return len(self._scenes) - 1

    def n_older(self, keyframe: Keyframe) -> int:
        """Return how many of the stored keyframes, the first ones, are old enough to be searched.

        Keyframes from before a loss of odometry are searched whatever their age.
        """
        n_older = int(np.searchsorted(self._segments.rows, keyframe.segment))
        newest_s = keyframe.stamp_s - self._params.min_age_s
        stamps_s = self._stamps_s.rows[n_older:]
        return n_older + int(np.searchsorted(stamps_s, newest_s, side="right"))

    def check(
        self, keyframe: Keyframe, ranked: Sequence[Candidate], n_older: int
    ) -> list[Candidate]:
        """Reject the candidates, of ``n_older`` searched, that fail; count and store the keyframe.

        Those that the ranking has rejected keep its reason.
        """
        checked = [self._check(keyframe, candidate) for candidate in ranked]
        if n_older:
            self._count(ranked, checked)
        self._store(keyframe, [candidate.match_id for candidate in checked])
        return checked

    def remember(self, keyframe: Keyframe, candidates: Sequence[Candidate]) -> None:
        """Store a keyframe with the candidates that it has been given before."""
        self._store(
            keyframe, [c.match_id for c in candidates if c.source != CandidateSource.PROXIMITY]
        )

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Forget the scene labels of keyframes that will not be candidates again."""
        for keyframe_id in keyframe_ids:
            self._scenes[keyframe_id] = None

    def begin_session(self) -> None:
        """Start the counts again."""
        self.counts = LoopCounts()

    def state(self) -> dict[str, Any]:
        """Return the state that keyframes and candidates do not contain, as JSON values."""
        return {"counts": asdict(self.counts)}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state, after its keyframes were stored."""
        self.counts = LoopCounts(**state["counts"])

    def _check(self, keyframe: Keyframe, candidate: Candidate) -> Candidate:
        """Measure semantic agreement and time consistency; reject a candidate that fails."""
        p = self._params
        candidate = replace(
            candidate,
            scene_agreement=scene_agreement(keyframe.scene, self._scenes[candidate.match_id]),
            n_consistent=self._count_consistent(candidate.match_id),
        )
        if candidate.decision:
            return candidate
        if candidate.scene_agreement < p.min_scene_agreement:
            reason = (
                f"scene labels contradict: agreement {candidate.scene_agreement:.2f} "
                f"below {p.min_scene_agreement:g}"
            )
        elif candidate.n_consistent < p.tc_required:
            reason = (
                f"time consistency: {candidate.n_consistent} of the last {p.tc} keyframes agree, "
                f"{p.tc_required} required"
            )
        elif p.upper_threshold is not None and candidate.eta > p.upper_threshold:
            reason = f"eta {candidate.eta:.3f} above {p.upper_threshold:g}: not verified"
            return replace(candidate, decision=Decision.ACCEPTED, reason=reason)
        else:
            return candidate
        return replace(candidate, decision=Decision.REJECTED, reason=reason)

    def _count(self, ranked: Sequence[Candidate], checked: Sequence[Candidate]) -> None:
        """Count a keyframe by the candidate that came furthest, before and after the checks."""
        grades = [self._grade(candidate) for candidate in ranked]
        if "candidate" in grades:
            self.counts.candidate += 1
            self.counts.approved += any(
                grade == "candidate" and candidate.decision != Decision.REJECTED
                for grade, candidate in zip(grades, checked, strict=True)
            )
        elif "between" in grades:
            self.counts.between += 1
        elif "unjudged" in grades:
            self.counts.unjudged += 1
        else:
            self.counts.discarded += 1

    def _grade(self, ranked: Candidate) -> str:
        p = self._params
        if ranked.decision:
            return "unjudged" if ranked.normaliser < p.min_normaliser else "discarded"
        # Candidates from views have no eta (NaN), which is not below the threshold.
        below_upper = p.upper_threshold is not None and ranked.eta <= p.upper_threshold
        return "between" if below_upper else "candidate"

    def _count_consistent(self, match_id: int) -> int:
        """Count the last ``tc`` keyframes that had a maximum near ``match_id``."""
        return sum(
            any(abs(other - match_id) <= self._params.max_index_difference for other in maxima)
            for maxima in self._maxima
        )

    def _store(self, keyframe: Keyframe, maxima: Sequence[int]) -> None:
        self._scenes.append(keyframe.scene)
        self._segments.append(keyframe.segment)
        self._stamps_s.append(keyframe.stamp_s)
        self._maxima.append(tuple(maxima))


def scene_agreement(a: Scene | None, b: Scene | None) -> float:
    """Return the agreement of two label distributions in [0, 1] (Bhattacharyya coefficient).

    It is 1 if a label is missing.
    """
    if a is None or b is None:
        return 1.0
    return float(np.sqrt(a.probabilities * b.probabilities).sum())


def find_maxima(scores: NDArray[np.floating], params: LoopParams) -> list[int]:
    """Return up to ``top_k`` ids with the highest scores above 0, none close to a better one."""
    return spread_maxima(
        np.arange(len(scores)),
        scores,
        max_n=params.top_k,
        separation=params.max_index_difference + 1,
    )
