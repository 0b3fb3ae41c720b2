"""Loop candidates by depth views: place recognition with relative poses."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.geometry import se3
from slam_bof.loops.candidate_checks import (
    CandidateChecks,
    LoopCounts,
    RankedCandidates,
    find_maxima,
)
from slam_bof.loops.params import LoopParams
from slam_bof.places import PlaceMatch, PlaceRecogniser
from slam_bof.types import (
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    EdgeKind,
    Keyframe,
    Loop,
    SavedConstellation,
)

__all__ = ["ViewLoopDetector"]


class ViewLoopDetector:
    """Finds loop candidates by the place recogniser; see ``LoopDetector``.

    Parameters
    ----------
    params
        Parameters of the search.
    gravity_odom
        (3,) rough direction of gravity in the odometry frame.
    seed
        Seed of the random samples that alignment draws.
    """

    def __init__(
        self, params: LoopParams, *, gravity_odom: ArrayLike = (0.0, 1.0, 0.0), seed: int = 0
    ) -> None:
        self._params = params
        self._recogniser = PlaceRecogniser(params.recogniser, gravity_odom=gravity_odom, seed=seed)
        self._checks = CandidateChecks(params)
        self.compare = self._recogniser.aligner.agreement

    @property
    def counts(self) -> LoopCounts:
        """Numbers of keyframes of this session by the stage that their search reached."""
        return self._checks.counts

    @property
    def newest(self) -> SavedConstellation | None:
        """The constellation of the keyframe stored last."""
        return self._recogniser.newest

    def find(self, keyframe: Keyframe, frame: DepthFrame) -> RankedCandidates:
        """Return up to ``top_k`` maxima of the score after alignment, and store the keyframe."""
        n_older = self._checks.n_older(keyframe)
        self._recogniser.add(frame, keyframe.T_odom_camera)
        matches = {m.view_id: m for m in self._recogniser.recognise(keyframe.id, n_older)}
        ranked = self._rank(keyframe, matches, n_older)
        return RankedCandidates(
            self._checks.check(keyframe, ranked, n_older),
            {c.match_id: matches[c.match_id].T_match_query for c in ranked},
        )

    def remember(
        self,
        keyframe: Keyframe,
        frame: DepthFrame,
        candidates: Sequence[Candidate],
        constellation: SavedConstellation | None = None,
    ) -> None:
        """Store a keyframe with what was found of it: candidates, constellation."""
        self._recogniser.add(frame, keyframe.T_odom_camera, constellation)
        self._checks.remember(keyframe, candidates)

    def on_loops_accepted(self, loops: Sequence[Loop]) -> None:
        """Exclude the newest keyframe from later searches if an older one has its viewpoint."""
        p = self._params
        if any(
            loop.query_id == self._checks.newest_id
            and loop.kind == EdgeKind.LOOP
            and np.linalg.norm(loop.T_match_query[:3, 3]) <= p.revisit_distance_m
            and se3.rotation_angle(loop.T_match_query) <= p.revisit_angle_rad
            for loop in loops
        ):
            self._recogniser.deactivate()

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Remove keyframes for good."""
        self._recogniser.remove(keyframe_ids)
        self._checks.remove(keyframe_ids)

    def begin_session(self, gravity_odom: ArrayLike) -> None:
        """Prepare for another direction of gravity, and follow no earlier matches."""
        self._recogniser.begin_session(gravity_odom)
        self._checks.begin_session()

    def state(self) -> dict[str, Any]:
        """Return the counts and the matches that are followed, as JSON values."""
        return self._checks.state() | {"ranking": self._recogniser.state()}

    def restore(self, state: dict[str, Any]) -> None:
        """Restore the counts and the matches that are followed."""
        self._checks.restore(state)
        self._recogniser.restore(state["ranking"])

    def _rank(
        self, keyframe: Keyframe, matches: Mapping[int, PlaceMatch], n_older: int
    ) -> list[Candidate]:
        """Return the best matches, no two close to each other, as candidates."""
        p = self._params
        scores = np.zeros(n_older)
        scores[list(matches)] = [match.score for match in matches.values()]
        candidates = []
        for best in find_maxima(scores, p):
            match = matches[best]
            candidate = Candidate(keyframe.id, best, CandidateSource.VIEW, score=match.score)
            if match.inlier_ratio < p.min_inlier_ratio:
                reason = (
                    f"both see {match.inlier_ratio:.2f} of the other, below {p.min_inlier_ratio:g}"
                )
                candidate = replace(candidate, decision=Decision.REJECTED, reason=reason)
            candidates.append(candidate)
        return candidates
