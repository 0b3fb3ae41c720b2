"""From candidates to loops: by geometry, by viewpoint, by agreement with other loops."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.loops.component_joining import ComponentJoiningGate
from slam_bof.loops.decisions import MapPoses, VerificationParams, decide
from slam_bof.loops.pairwise_consistency import ConsistencyGate
from slam_bof.places import Compare
from slam_bof.ports import ForgettingVerifier, Verifier
from slam_bof.types import (
    Array,
    Candidate,
    CandidateSource,
    Decision,
    DepthFrame,
    EdgeKind,
    Loop,
    Pose,
    Verification,
)

__all__ = ["LoopVerification", "Verified"]


class Verified(NamedTuple):
    """The decisions about a keyframe's candidates, and the edges that follow from them."""

    candidates: list[Candidate]
    """The candidates with figures, decision and reason; one that is ``held`` waits for others."""
    measured: list[Loop]
    """All that geometry accepts, held ones too."""
    admitted: list[Loop]
    """The edges to add now, among them loops of earlier keyframes held back so far."""


class LoopVerification:
    """Keeps the keyframes as the verifier has prepared them, and verifies candidates.

    Attributes
    ----------
    n_global_registrations
        Number of pairs that were registered without an initial pose.
    """

    def __init__(
        self,
        verifier: Verifier,
        params: VerificationParams,
        *,
        compare: Compare | None = None,
        seed: int = 0,
    ) -> None:
        self.params = params
        self._verifier = verifier
        self._gate = ConsistencyGate(params.consistency)
        self._join_gate = ComponentJoiningGate(params.component_joining, compare)
        self._seed = seed
        self.n_global_registrations = 0
        self._prepared: list[Any] = []

    def add(self, frame: DepthFrame, points_camera: Array) -> None:
        """Take the next keyframe: its depth image, and the points (N, 3) chosen of it."""
        self._prepared.append(self._verifier.prepare(frame, points_camera))

    def remove(self, keyframe_ids: Collection[int]) -> None:
        """Forget what was prepared of keyframes that will not be verified again."""
        for keyframe_id in keyframe_ids:
            if isinstance(self._verifier, ForgettingVerifier):
                self._verifier.forget(self._prepared[keyframe_id])
            self._prepared[keyframe_id] = None

    @property
    def waiting(self) -> set[int]:
        """Ids of the keyframes of loops that wait for others to agree."""
        loops = [*self._gate.waiting, *self._join_gate.waiting]
        return {id_ for loop in loops for id_ in (loop.query_id, loop.match_id)}

    def align(
        self,
        candidates: Sequence[Candidate],
        T_map_camera: Array,
        guesses: Mapping[int, Pose] = MappingProxyType({}),
    ) -> list[Verification | None]:
        """Align the newest keyframe with each candidate; None for those rejected already.

        It starts from the guess, or else from the poses that the map has for the two. Candidates of
        bags for which that fails are registered without an initial pose, which costs ten times as
        much; see ``global_registration``.

        Parameters
        ----------
        candidates
            The candidates of the newest keyframe.
        T_map_camera
            (K, 4, 4) poses of all keyframes in the map so far.
        guesses
            ``T_match_query`` that recognition has found, by ``match_id``.
        """
        chosen = [k for k, c in enumerate(candidates) if c.decision != Decision.REJECTED]
        if not chosen:
            return [None] * len(candidates)
        query_id = candidates[0].query_id
        match_ids = [candidate.match_id for candidate in candidates]
        T_match_query = se3.inverse(T_map_camera[match_ids]) @ T_map_camera[query_id]
        for k, match_id in enumerate(match_ids):
            T_match_query[k] = guesses.get(match_id, T_match_query[k])
        query = self._prepared[query_id]
        matches = [self._prepared[match_id] for match_id in match_ids]
        guessed = [k for k in chosen if not self._is_unguessed(candidates[k])]
        found = self._verifier.verify(
            query, [matches[k] for k in guessed], T_match_query=T_match_query[guessed]
        )
        verified = dict(zip(guessed, found, strict=True))
        unguessed = [
            k
            for k in chosen
            if candidates[k].source == CandidateSource.BAG
            and not (k in verified and verified[k].accepted)
        ]
        found = self._verifier.verify(query, [matches[k] for k in unguessed], seed=self._seed)
        self.n_global_registrations += len(unguessed)
        verified |= zip(unguessed, found, strict=True)
        return [verified.get(k) for k in range(len(candidates))]

    def decide(
        self,
        candidates: Sequence[Candidate],
        aligned: Sequence[Verification | None],
        poses: MapPoses,
    ) -> Verified:
        """Accept or reject the candidates of the newest keyframe that are still open.

        Candidates that recognition has accepted are aligned only to measure their pose. They are
        rejected only if too few points meet to determine it.

        Parameters
        ----------
        candidates, aligned
            The candidates, and the answers of ``align``.
        poses
            The poses of all keyframes in the map so far.
        """
        decided: list[Candidate] = []
        edges: list[Loop] = []
        loops: list[Loop] = []
        for candidate, verified in zip(candidates, aligned, strict=True):
            if verified is not None:
                candidate = decide(candidate, verified, poses, self.params)
                if candidate.decision == Decision.ACCEPTED:
                    is_loop = candidate.kind == EdgeKind.LOOP
                    (loops if is_loop else edges).append(_edge(candidate, verified))
            decided.append(candidate)
        admitted = self.admit(loops, poses.T_map_camera, poses.components)
        return Verified(_hold(decided, admitted, poses), edges + loops, edges + admitted)

    def admit(
        self, loops: Sequence[Loop], T_map_camera: Array, components: NDArray[np.integer[Any]]
    ) -> list[Loop]:
        """Take the newest keyframe's verified loops; return those that others agree with now."""
        within = [loop for loop in loops if components[loop.query_id] == components[loop.match_id]]
        between = [loop for loop in loops if components[loop.query_id] != components[loop.match_id]]
        admitted = self._gate.admit(within, T_map_camera, components)
        return admitted + self._join_gate.admit(between, T_map_camera, components)

    def _is_unguessed(self, candidate: Candidate) -> bool:
        """Return whether a candidate is registered without an initial pose in any case."""
        return (
            self.params.global_registration == "always"
            and candidate.source == CandidateSource.BAG
            and candidate.decision == Decision.OPEN
        )


def _edge(candidate: Candidate, verified: Verification) -> Loop:
    """Return the edge of the pose graph that an accepted candidate becomes."""
    return Loop(
        candidate.query_id,
        candidate.match_id,
        verified.T_match_query,
        verified.information,
        candidate.kind,
        candidate.source,
    )


def _hold(decided: list[Candidate], admitted: list[Loop], poses: MapPoses) -> list[Candidate]:
    """Mark the loops that were verified but not admitted yet."""
    pairs = {(loop.query_id, loop.match_id) for loop in admitted}

    def hold(candidate: Candidate) -> Candidate:
        pair = candidate.query_id, candidate.match_id
        if (
            candidate.decision != Decision.ACCEPTED
            or candidate.kind != EdgeKind.LOOP
            or pair in pairs
        ):
            return candidate
        reason = "no loop of another keyframe agrees with it"
        if poses.joins_components(candidate):
            reason = "not enough yet to join two components"
        return replace(candidate, decision=Decision.HELD, reason=reason)

    return [hold(candidate) for candidate in decided]
