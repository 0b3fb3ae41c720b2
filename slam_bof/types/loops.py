"""Candidates for edges of the pose graph, their verification, and loops."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from slam_bof.types.poses import Array, Pose

__all__ = ["Candidate", "CandidateSource", "Decision", "EdgeKind", "Loop", "Verification"]


@dataclass(frozen=True, slots=True, eq=False)
class Verification:
    """The result of registering a pair of keyframes.

    ``overlap`` is the share of the query's points that have a corresponding point in the match,
    and ``rmse_m`` is their point-to-plane error. ``information`` (6, 6) is that of the tangent of
    ``T_match_query``, rotation first (the convention of GTSAM). ``reason`` says in words why
    ``accepted`` is false.
    """

    accepted: bool
    reason: str
    T_match_query: Pose
    overlap: float
    rmse_m: float
    information: Array


class CandidateSource(StrEnum):
    """The method that proposed a pair of keyframes."""

    VIEW = "view"
    """Place recognition by depth views."""
    BAG = "bag"
    """Place recognition by bags of BOF words, as in the paper."""
    PROXIMITY = "proximity"
    """The poses of the map: according to them both keyframes see the same surfaces."""
    PRUNED = "pruned"
    """Pruning: the edge replaces keyframes that were removed between the two."""


class EdgeKind(StrEnum):
    """The kind of an edge between two keyframes."""

    LOOP = "loop"
    """A revisit: the two are far apart in time and passed all checks for loops."""
    COVISIBILITY = "covisibility"
    """Two neighbours in time or in the map that see the same surfaces."""


class Decision(StrEnum):
    """The decision about a candidate."""

    OPEN = ""
    """Not decided yet."""
    ACCEPTED = "accepted"
    REJECTED = "rejected"
    HELD = "held"
    """Verified by geometry. It enters the graph when other loops agree with it."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One line of the audit trail: a pair of keyframes that was considered as an edge.

    ``reason`` explains the decision in words. It is empty if the pair passed every check.
    """

    query_id: int
    match_id: int
    source: CandidateSource
    kind: EdgeKind = EdgeKind.LOOP
    score: float = float("nan")
    normaliser: float = float("nan")
    eta: float = float("nan")
    scene_agreement: float = float("nan")
    n_consistent: int = 0
    overlap: float = float("nan")
    rmse_m: float = float("nan")
    decision: Decision = Decision.OPEN
    reason: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Loop:
    """A verified edge of the pose graph between two keyframes.

    ``information`` (6, 6) is that of the tangent of ``T_match_query``, rotation first.
    """

    query_id: int
    match_id: int
    T_match_query: Pose
    information: Array
    kind: EdgeKind
    source: CandidateSource
