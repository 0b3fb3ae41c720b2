"""Loop candidates: which older keyframes may show the place that the newest one shows.

By *views* (``recogniser``), the product's way, or by *bags* of words, the paper's (section 3.4):
for keyframe N and an older keyframe i, the score ``s(i, N)`` of their bags is divided by the
score against the keyframe about one second before N, which tells what a good score is worth
here: ``eta(i, N) = s(i, N) / s(N - tau, N)``. Either way the best are checked for contradicting
scene labels and for time consistency. What is left open goes to geometric verification; what
is above the upper threshold is accepted already, and goes there for its relative pose.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof import se3
from slam_bof.index import InvertedIndex
from slam_bof.recogniser import Compare, PlaceRecogniser, RecogniserParams
from slam_bof.types import Candidate, DepthFrame, Keyframe, Loop, Params, Pose, Scene

__all__ = ["Found", "LoopCounts", "LoopDetector", "LoopParams", "scene_agreement"]


class LoopParams(Params):
    """The parameters of Table 10, and what the product adds to them."""

    by: Literal["views", "bags"] = "views"
    upper_threshold: float | None = Field(
        None, ge=0, description="bags: eta above it: accepted unverified; null: all are verified"
    )
    lower_threshold: float = Field(0.4, ge=0, description="bags: eta below it: discarded")
    normaliser_lag_s: float = Field(1.0, gt=0, description="bags: N, or tau, as a time")
    min_normaliser: float = Field(0.05, ge=0, description="bags: below it not judged")
    min_seen: float = Field(0.4, ge=0, le=1, description="views: share of points both see")
    recogniser: RecogniserParams = RecogniserParams()
    repeat_m: float = Field(0.2, ge=0, description="views: who has a loop to nearer than this")
    repeat_rad: float = Field(0.2, ge=0, description="and turned by less is not searched for")
    tc: int = Field(3, ge=0, description="keyframes that the time consistency check runs over")
    tc_required: int = Field(1, ge=0, description="of which so many must agree")
    max_index_difference: int = Field(3, ge=0, description="keyframes apart that still agree")
    top_k: int = Field(3, gt=0, description="candidates a keyframe; 1 in the paper")
    min_age_s: float = Field(3.0, ge=0, description="younger keyframes are not loops")
    min_scene_agreement: float = Field(0.2, ge=0, le=1, description="below it labels contradict")


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


@dataclass(slots=True)
class LoopCounts:
    """Keyframes by how far their search for a loop came: the outputs of the paper's Table 10.

    Only keyframes with older ones to search; each is in one of ``candidate``, ``between``,
    ``discarded`` and ``unjudged``, with several candidates by the one that came furthest.

    Parameters
    ----------
    candidate
        Pass the upper threshold; where there is none, the lower one.
    approved
        Of these, pass time consistency, and the check of scene labels.
    between
        Neither pass the upper threshold nor stay below the lower one.
    discarded
        Stay below the lower threshold (by views: of what both see), or nothing is alike at all.
    unjudged
        The normaliser is below its floor.
    """

    candidate: int = 0
    approved: int = 0
    between: int = 0
    discarded: int = 0
    unjudged: int = 0


class LoopDetector:
    """Finds, for each keyframe in turn, the older ones that may show the same place.

    Parameters
    ----------
    params
        By which means, and what a candidate needs.
    n_words
        Words of the vocabulary, for bags.
    gravity_odom
        (3,) roughly down in the odometry's frame, for views.
    seed
        Of what aligning views draws at random.

    Attributes
    ----------
    compare
        Measures how far a keyframe agrees with others at given poses; None by bags.
    """

    def __init__(
        self,
        params: LoopParams,
        n_words: int,
        *,
        gravity_odom: ArrayLike = (0.0, 1.0, 0.0),
        seed: int = 0,
    ) -> None:
        self.params = params
        self.counts = LoopCounts()
        self.compare: Compare | None = None
        self._ranking: _Ranking
        if params.by == "bags":
            self._ranking = _Bags(params, n_words)
        else:
            recogniser = PlaceRecogniser(params.recogniser, gravity_odom=gravity_odom, seed=seed)
            self.compare = recogniser.agreement
            self._ranking = _Views(params, recogniser)
        self._keyframes: list[Keyframe] = []
        self._maxima: list[tuple[int, ...]] = []

    def find(self, keyframe: Keyframe, frame: DepthFrame) -> Found:
        """Return the keyframe's candidates, and remember the keyframe."""
        stamps_s = [k.stamp_s for k in self._keyframes]
        n_old = np.searchsorted(stamps_s, keyframe.stamp_s - self.params.min_age_s, side="right")
        # What was seen before odometry was lost is a place to be found again, however young.
        segments = [k.segment for k in self._keyframes]
        n_old = max(n_old, np.searchsorted(segments, keyframe.segment))
        found = self._ranking.rank(keyframe, frame, self._keyframes[: int(n_old)])
        checked = [self._check(keyframe, candidate) for candidate in found.candidates]
        if n_old:
            self._count(found.candidates, checked)
        self._maxima.append(tuple(c.match_id for c in checked))
        self._keyframes.append(keyframe)
        return replace(found, candidates=checked)

    def note(self, loops: Sequence[Loop]) -> None:
        """Note accepted loops: where an older keyframe stands, the last is not searched for.

        By bags all are found, as the paper has it.
        """
        p, newest = self.params, self._keyframes[-1].id
        if any(
            loop.query_id == newest
            and loop.kind == "loop"
            and np.linalg.norm(loop.T_match_query[:3, 3]) <= p.repeat_m
            and se3.rotation_angle(loop.T_match_query) <= p.repeat_rad
            for loop in loops
        ):
            self._ranking.set_aside()

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
            return replace(candidate, decision="accepted", reason=reason)
        else:
            return candidate
        return replace(candidate, decision="rejected", reason=reason)

    def _count(self, ranked: list[Candidate], checked: list[Candidate]) -> None:
        """Count a keyframe by the candidate that came furthest, before and after the checks."""
        grades = [self._grade(candidate) for candidate in ranked]
        if "candidate" in grades:
            self.counts.candidate += 1
            self.counts.approved += any(
                grade == "candidate" and candidate.decision != "rejected"
                for grade, candidate in zip(grades, checked, strict=True)
            )
        elif "between" in grades:
            self.counts.between += 1
        elif "unjudged" in grades:
            self.counts.unjudged += 1
        else:
            self.counts.discarded += 1

    def _grade(self, ranked: Candidate) -> str:
        p = self.params
        if ranked.decision:
            return "unjudged" if ranked.normaliser < p.min_normaliser else "discarded"
        # What views propose has no eta, and passes.
        below_upper = p.upper_threshold is not None and ranked.eta <= p.upper_threshold
        return "between" if below_upper else "candidate"

    def _count_consistent(self, match_id: int) -> int:
        """Count the last ``tc`` keyframes that had a maximum near ``match_id``."""
        p = self.params
        recent = self._maxima[-p.tc :] if p.tc else []
        return sum(
            any(abs(other - match_id) <= p.max_index_difference for other in maxima)
            for maxima in recent
        )


class _Ranking(Protocol):
    """A way to find what looks alike."""

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return the best of the older keyframes, and remember this one."""

    def set_aside(self) -> None:
        """Find others rather than the one ranked last."""


class _Bags:
    """The paper's: the maxima of eta."""

    def __init__(self, params: LoopParams, n_words: int) -> None:
        self._params = params
        self._index = InvertedIndex(n_words)
        self._stamps_s: list[float] = []

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return up to ``top_k`` maxima of eta, no two within ``max_index_difference``."""
        p = self._params
        scores = self._index.scores(keyframe.bag)
        self._index.add(keyframe.bag)
        found = Found()
        if older:
            lag = np.abs(np.array(self._stamps_s) - (keyframe.stamp_s - p.normaliser_lag_s))
            normaliser = float(scores[lag.argmin()])
            for best in _maxima(scores[: len(older)], p):
                score = float(scores[best])
                eta = score / normaliser if normaliser > 0.0 else np.inf
                candidate = Candidate(
                    keyframe.id, best, "bag", score=score, normaliser=normaliser, eta=eta
                )
                found.candidates.append(self._judge(candidate))
        self._stamps_s.append(keyframe.stamp_s)
        return found

    def set_aside(self) -> None:
        """Do nothing: the paper's index holds all."""

    def _judge(self, candidate: Candidate) -> Candidate:
        p = self._params
        if candidate.normaliser < p.min_normaliser:
            reason = f"normaliser {candidate.normaliser:.3f} below {p.min_normaliser:g}: not judged"
        elif candidate.eta < p.lower_threshold:
            reason = f"eta {candidate.eta:.3f} below {p.lower_threshold:g}"
        else:
            return candidate
        return replace(candidate, decision="rejected", reason=reason)


class _Views:
    """The recogniser's: the maxima of what it ranks by, after aligning."""

    def __init__(self, params: LoopParams, recogniser: PlaceRecogniser) -> None:
        self._params = params
        self._recogniser = recogniser

    def rank(self, keyframe: Keyframe, frame: DepthFrame, older: list[Keyframe]) -> Found:
        """Return up to ``top_k`` maxima of the score, no two within ``max_index_difference``."""
        p = self._params
        view_id = self._recogniser.add(frame, keyframe.T_odom_camera)
        matches = {m.view_id: m for m in self._recogniser.recognise(view_id, len(older))}
        scores = np.zeros(len(older))
        scores[list(matches)] = [m.score for m in matches.values()]
        candidates = []
        for best in _maxima(scores, p):
            match = matches[best]
            candidate = Candidate(keyframe.id, best, "view", score=match.score)
            if match.seen < p.min_seen:
                reason = f"both see {match.seen:.2f} of the other, below {p.min_seen:g}"
                candidate = replace(candidate, decision="rejected", reason=reason)
            candidates.append(candidate)
        return Found(
            candidates, {c.match_id: matches[c.match_id].T_match_query for c in candidates}
        )

    def set_aside(self) -> None:
        self._recogniser.set_aside()


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


def scene_agreement(a: Scene | None, b: Scene | None) -> float:
    """Return how well two label distributions agree, in [0, 1] (Bhattacharyya coefficient).

    Without a label on either side nothing contradicts: 1.
    """
    if a is None or b is None:
        return 1.0
    return float(np.sqrt(a.probabilities * b.probabilities).sum())
