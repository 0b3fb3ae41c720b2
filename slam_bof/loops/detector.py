"""Loop candidates: older keyframes that may show the same place as the newest one.

They are proposed by depth views (``PlaceRecogniser``) or by bags of words, as in the paper
(section 3.4). There, the score ``s(i, N)`` of keyframe N and an older keyframe i is divided by the
score against the keyframe about one second before N, which shows how high scores are in this
place: ``eta(i, N) = s(i, N) / s(N - tau, N)``. In both cases the best candidates are checked for
contradicting scene labels and for time consistency. Open candidates are verified by geometry.
Candidates above the upper threshold are accepted, and geometry only measures their relative pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.core import GrowingArray
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
    SavedConstellation,
    Scene,
)

__all__ = ["LoopCounts", "LoopDetector", "LoopParams", "scene_agreement"]


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


class LoopDetector:
    """Finds the older keyframes that may show the same place as each new keyframe.

    Parameters
    ----------
    params
        Parameters of the search.
    n_words
        Number of words of the vocabulary, for bags.
    gravity_odom
        (3,) rough direction of gravity in the odometry frame, for views.
    seed
        Seed of the random samples that alignment draws.

    Attributes
    ----------
    compare
        Measures the agreement of a keyframe with others at given poses; None with bags.
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
        self._scenes: list[Scene | None] = []
        self._segments = GrowingArray((), np.int64)
        self._stamps_s = GrowingArray((), np.float64)
        self._maxima: deque[tuple[int, ...]] = deque(maxlen=params.tc)

    def find(self, keyframe: Keyframe, frame: DepthFrame, *, search: bool = True) -> Found:
        """Return the candidates of a keyframe, none without ``search``, and store it."""
        if not search:
            self.remember(keyframe, frame, [])
            return Found()
        # Keyframes from before a loss of odometry are searched whatever their age.
        n_old = int(np.searchsorted(self._segments.rows, keyframe.segment))
        stamps_s = self._stamps_s.rows[n_old:]
        n_old += int(
            np.searchsorted(stamps_s, keyframe.stamp_s - self.params.min_age_s, side="right")
        )
        found = self._ranking.rank(keyframe, frame, n_old)
        checked = [self._check(keyframe, candidate) for candidate in found.candidates]
        if n_old:
            self._count(found.candidates, checked)
        self._store(keyframe, [c.match_id for c in checked])
        return replace(found, candidates=checked)

    @property
    def newest(self) -> SavedConstellation | None:
        """The constellation of the keyframe stored last, None with bags."""
        return self._ranking.newest

    def remember(
        self,
        keyframe: Keyframe,
        frame: DepthFrame,
        candidates: Sequence[Candidate],
        constellation: SavedConstellation | None = None,
    ) -> None:
        """Store a keyframe of a saved map with what was found of it: candidates, constellation."""
        self._ranking.remember(keyframe, frame, constellation)
        self._store(
            keyframe, [c.match_id for c in candidates if c.source != CandidateSource.PROXIMITY]
        )

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Remove keyframes from all later searches."""
        self._ranking.remove(keyframe_ids)
        for keyframe_id in keyframe_ids:
            self._scenes[keyframe_id] = None

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for keyframes with another odometry frame and its rough gravity (3,)."""
        self.counts = LoopCounts()
        self._ranking.begin_session(gravity_odom)

    def state(self) -> dict[str, Any]:
        """Return the state that keyframes and candidates do not contain, as JSON values."""
        return {"counts": asdict(self.counts), "ranking": self._ranking.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore a state, after its keyframes were stored."""
        self.counts = LoopCounts(**state["counts"])
        self._ranking.restore(state["ranking"])

    def on_loops_accepted(self, loops: Sequence[Loop]) -> None:
        """Exclude the newest keyframe from later searches if an older one has the same viewpoint.

        With bags all keyframes are searched, as in the paper.
        """
        p, newest = self.params, len(self._scenes) - 1
        if any(
            loop.query_id == newest
            and loop.kind == EdgeKind.LOOP
            and np.linalg.norm(loop.T_match_query[:3, 3]) <= p.revisit_distance_m
            and se3.rotation_angle(loop.T_match_query) <= p.revisit_angle_rad
            for loop in loops
        ):
            self._ranking.deactivate()

    def _check(self, keyframe: Keyframe, candidate: Candidate) -> Candidate:
        """Measure semantic agreement and time consistency; reject a candidate that fails."""
        p = self.params
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
        # Candidates from views have no eta (NaN), which is not below the threshold.
        below_upper = p.upper_threshold is not None and ranked.eta <= p.upper_threshold
        return "between" if below_upper else "candidate"

    def _count_consistent(self, match_id: int) -> int:
        """Count the last ``tc`` keyframes that had a maximum near ``match_id``."""
        return sum(
            any(abs(other - match_id) <= self.params.max_index_difference for other in maxima)
            for maxima in self._maxima
        )

    def _store(self, keyframe: Keyframe, maxima: list[int]) -> None:
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
