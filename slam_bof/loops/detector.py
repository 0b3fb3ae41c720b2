"""Loop candidates: which older keyframes may show the place that the newest one shows.

By *views* (``recogniser``), the product's way, or by *bags* of words, the paper's (section 3.4):
for keyframe N and an older keyframe i, the score ``s(i, N)`` of their bags is divided by the
score against the keyframe about one second before N, which tells what a good score is worth
here: ``eta(i, N) = s(i, N) / s(N - tau, N)``. Either way the best are checked for contradicting
scene labels and for time consistency. What is left open goes to geometric verification; what
is above the upper threshold is accepted already, and goes there for its relative pose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.geometry import se3
from slam_bof.loops.candidates import BagRanking, Found, Ranking, ViewRanking
from slam_bof.loops.params import LoopParams
from slam_bof.places import Compare, PlaceRecogniser
from slam_bof.types import (
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    EdgeKind,
    Keyframe,
    Loop,
    Scene,
)

__all__ = ["LoopCounts", "LoopDetector", "LoopParams", "scene_agreement"]


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
        self._ranking: Ranking
        if params.by == "bags":
            self._ranking = BagRanking(params, n_words)
        else:
            recogniser = PlaceRecogniser(params.recogniser, gravity_odom=gravity_odom, seed=seed)
            self.compare = recogniser.aligner.agreement
            self._ranking = ViewRanking(params, recogniser)
        self._keyframes: list[Keyframe] = []
        self._maxima: list[tuple[int, ...]] = []

    def find(self, keyframe: Keyframe, frame: DepthFrame) -> Found:
        """Return the keyframe's candidates, and remember the keyframe."""
        # What was seen before odometry was lost is a place to be found again, however young.
        n_old = int(np.searchsorted([k.segment for k in self._keyframes], keyframe.segment))
        stamps_s = [k.stamp_s for k in self._keyframes[n_old:]]
        n_old += int(
            np.searchsorted(stamps_s, keyframe.stamp_s - self.params.min_age_s, side="right")
        )
        found = self._ranking.rank(keyframe, frame, self._keyframes[:n_old])
        checked = [self._check(keyframe, candidate) for candidate in found.candidates]
        if n_old:
            self._count(found.candidates, checked)
        self._maxima.append(tuple(c.match_id for c in checked))
        self._keyframes.append(keyframe)
        return replace(found, candidates=checked)

    def remember(
        self, keyframe: Keyframe, frame: DepthFrame, candidates: Sequence[Candidate]
    ) -> None:
        """Take a keyframe of a saved map, whose candidates were found when it was made."""
        self._ranking.remember(keyframe, frame)
        self._maxima.append(
            tuple(c.match_id for c in candidates if c.source != CandidateSource.PROXIMITY)
        )
        self._keyframes.append(keyframe)

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Expect keyframes of another odometry, down in whose frame is ``gravity_odom`` (3,)."""
        self.counts = LoopCounts()
        self._ranking.begin_session(gravity_odom)

    def state(self) -> dict[str, Any]:
        """Return what keyframes and candidates do not tell, as JSON has it."""
        return {"counts": asdict(self.counts), "ranking": self._ranking.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Go on from a state, with the keyframes remembered that it was of."""
        self.counts = LoopCounts(**state["counts"])
        self._ranking.restore(state["ranking"])

    def on_loops_accepted(self, loops: Sequence[Loop]) -> None:
        """Note accepted loops: where an older keyframe stands, the last is not searched for.

        By bags all are found, as the paper has it.
        """
        p, newest = self.params, self._keyframes[-1].id
        if any(
            loop.query_id == newest
            and loop.kind == EdgeKind.LOOP
            and np.linalg.norm(loop.T_match_query[:3, 3]) <= p.revisit_distance_m
            and se3.rotation_angle(loop.T_match_query) <= p.revisit_angle_rad
            for loop in loops
        ):
            self._ranking.deactivate()

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
            return replace(candidate, decision=Decision.ACCEPTED, reason=reason)
        else:
            return candidate
        return replace(candidate, decision=Decision.REJECTED, reason=reason)

    def _count(self, ranked: list[Candidate], checked: list[Candidate]) -> None:
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


def scene_agreement(a: Scene | None, b: Scene | None) -> float:
    """Return how well two label distributions agree, in [0, 1] (Bhattacharyya coefficient).

    Without a label on either side nothing contradicts: 1.
    """
    if a is None or b is None:
        return 1.0
    return float(np.sqrt(a.probabilities * b.probabilities).sum())
