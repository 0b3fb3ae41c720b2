"""Loops held to geometry, viewpoint, drift and each other, with an exact verifier as partner."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.loops import LoopVerification, MapPoses, VerificationParams
from slam_bof.loops.pairwise_consistency import ConsistencyParams
from slam_bof.ports import Verifier
from slam_bof.types import Candidate, DepthFrame, Intrinsics, Verification

ALONE = VerificationParams(consistency=ConsistencyParams(n_required=0))
UNSEEN = DepthFrame(0.0, np.zeros((1, 1), np.uint16), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0))
STAND = np.tile(np.eye(4), (3, 1, 1))


@dataclass
class CentroidVerifier:
    """A real, if simple-minded, verifier: clouds are aligned by their centroids."""

    overlap: float = 0.9
    turn_rad: float = 0.0
    information: np.ndarray = field(default_factory=lambda: np.eye(6))
    n_open: int = 0

    def prepare(self, frame, points_camera):
        return points_camera.mean(axis=0)

    def verify(self, query, matches, *, T_match_query=None, seed=0):
        return [self.verify_one(query, match) for match in matches]

    def verify_one(self, query, match):
        T = se3.exp(np.array([0.0, self.turn_rad, 0.0, 0.0, 0.0, 0.0]))
        T[:3, 3] = match - query
        accepted = self.overlap > 0.5
        return Verification(
            accepted,
            "" if accepted else "too little",
            T,
            self.overlap,
            0.01,
            self.information,
            self.n_open,
        )


def on_the_spot(path_m=(0.0, 0.0, 0.0), components=(0, 0, 0)):
    """Return a map of three keyframes of one pose, and the lengths of paths to the last."""
    return MapPoses(STAND, np.array(path_m), np.array(components))


def verify(verifier, candidate, *, shift_m=0.0, params=ALONE, poses=None):
    verification = LoopVerification(verifier, params)
    points = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 3.0]])
    for offset_m in (0.0, 0.0, shift_m):
        verification.add(UNSEEN, points + np.array([offset_m, 0.0, 0.0]))
    aligned = verification.align([candidate], STAND)
    found = verification.decide([candidate], aligned, poses or on_the_spot())
    return found.candidates[0], found.admitted


def candidate(source="bag", kind="loop", **figures):
    return Candidate(2, 0, source, kind, **figures)


def test_the_partner_is_a_verifier():
    assert isinstance(CentroidVerifier(), Verifier)


def test_a_good_pair_becomes_a_loop_with_its_measured_pose():
    judged, (loop,) = verify(CentroidVerifier(), candidate(eta=0.8), shift_m=0.2)
    assert (judged.decision, judged.reason) == ("accepted", "")
    assert (judged.eta, judged.overlap, judged.rmse_m) == (0.8, 0.9, 0.01)
    assert (loop.query_id, loop.match_id, loop.kind, loop.source) == (2, 0, "loop", "bag")
    np.testing.assert_allclose(loop.T_match_query[:3, 3], [-0.2, 0.0, 0.0])


def test_what_was_rejected_before_is_passed_on_untouched():
    before = candidate(decision="rejected", reason="eta 0.1 below 0.4")
    assert verify(CentroidVerifier(), before) == (before, [])


def test_what_is_accepted_already_gets_its_pose_and_no_veto():
    before = candidate(decision="accepted", reason="eta 0.9 above 0.8: not verified")
    judged, (loop,) = verify(CentroidVerifier(overlap=0.3), before, shift_m=1.2)
    assert judged.decision == "accepted"
    assert judged.reason == "eta 0.9 above 0.8: not verified; geometry objects: too little"
    np.testing.assert_allclose(loop.T_match_query[:3, 3], [-1.2, 0.0, 0.0])


@pytest.mark.parametrize("information", [np.zeros((6, 6)), np.diag([1.0, 1, 1, 1, 1, 0])])
def test_what_is_accepted_already_is_no_edge_while_its_pose_is_open(information):
    before = candidate(decision="accepted", reason="eta 0.9 above 0.8: not verified")
    judged, loops = verify(CentroidVerifier(overlap=0.3, information=information), before)
    assert judged.decision == "rejected"
    assert judged.reason == "eta 0.9 above 0.8: not verified; no relative pose: too little"
    assert loops == []


@pytest.mark.parametrize(
    ("verifier", "changes", "reason"),
    [
        (CentroidVerifier(overlap=0.3), {}, "too little"),
        (CentroidVerifier(overlap=0.55), {}, "that a loop needs"),
        (CentroidVerifier(turn_rad=1.0), {}, "views too far apart"),
        (CentroidVerifier(), {"shift_m": 1.2}, "views too far apart"),
        (CentroidVerifier(), {"shift_m": 0.9}, "more than drift"),
        (CentroidVerifier(turn_rad=0.5), {}, "more than drift"),
    ],
)
def test_a_loop_is_rejected_with_the_reason_in_words(verifier, changes, reason):
    judged, loops = verify(verifier, candidate(), **changes)
    assert judged.decision == "rejected"
    assert reason in judged.reason
    assert loops == []


@pytest.mark.parametrize(("path_m", "decision"), [(10.0, "accepted"), (5.0, "rejected")])
def test_a_long_path_allows_for_more_drift(path_m, decision):
    poses = on_the_spot(path_m=(path_m, 5.0, 0.0))
    judged, _ = verify(CentroidVerifier(), candidate(), shift_m=0.9, poses=poses)
    assert judged.decision == decision


def test_neighbours_need_less_than_loops():
    near = candidate("proximity", "covisibility")
    judged, (edge,) = verify(CentroidVerifier(overlap=0.55), near)
    assert judged.decision == "accepted"
    assert edge.kind == "covisibility"


def test_a_lonely_loop_is_held():
    judged, loops = verify(CentroidVerifier(), candidate(), params=VerificationParams())
    assert judged.decision == "held"
    assert loops == []


@pytest.mark.parametrize("source", ["bag", "view"])
def test_a_loop_needs_all_directions(source):
    decision = "accepted" if source == "view" else ""
    candidate = Candidate(2, 0, source, decision=decision)
    judged, admitted = verify(CentroidVerifier(n_open=2), candidate)
    assert judged.decision == "rejected"
    assert "leave 2 of 6 directions open" in judged.reason
    assert admitted == []


def test_a_neighbour_with_open_directions_is_a_partial_edge():
    candidate = Candidate(2, 0, "proximity", "covisibility")
    judged, (edge,) = verify(CentroidVerifier(n_open=1), candidate)
    assert judged.decision == "accepted"
    assert judged.kind == edge.kind == "partial"


class RecordingVerifier(CentroidVerifier):
    """Notes of every pair whether it came with an initial pose."""

    def verify(self, query, matches, *, T_match_query=None, seed=0):
        self.guessed = [
            *getattr(self, "guessed", []),
            *([T_match_query is not None] * len(matches)),
        ]
        return super().verify(query, matches)


@pytest.mark.parametrize(
    ("when", "decision", "n_global"),
    [("if_needed", "", 0), ("always", "", 1), ("always", "accepted", 0)],
)
def test_open_candidates_are_registered_without_a_guess_if_always_asked(when, decision, n_global):
    verifier = RecordingVerifier()
    params = ALONE.model_copy(update={"global_registration": when})
    verification = LoopVerification(verifier, params)
    for _ in range(3):
        verification.add(UNSEEN, np.array([[0.0, 0.0, 1.0]]))
    candidates = [candidate(decision=decision)]
    found = verification.decide(candidates, verification.align(candidates, STAND), on_the_spot())
    assert len(found.admitted) == 1
    assert verifier.guessed == [n_global == 0]
    assert verification.n_global_registrations == n_global
