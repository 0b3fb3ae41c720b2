import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.loops import LoopCounts, LoopParams, make_loop_detector
from slam_bof.loops.candidate_checks import scene_agreement
from slam_bof.types import Bag, DepthFrame, Intrinsics, Keyframe, Scene

N_WORDS = 8
CLASSES = ("kitchen", "office")
UNSEEN = DepthFrame(0.0, np.zeros((1, 1), np.uint16), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0))
"""Bags do not look at the frame."""


def bag(*words):
    """A bag with the given words, one count each."""
    found, counts = np.unique(words, return_counts=True)
    return Bag(found.astype(np.int32), (counts / counts.sum()).astype(np.float32))


def scene(p_kitchen):
    probabilities = np.array([p_kitchen, 1.0 - p_kitchen])
    best = int(probabilities.argmax())
    return Scene(CLASSES[best], float(probabilities[best]), CLASSES, probabilities)


def keyframes(bags, scenes=None, period_s=1.0):
    scenes = scenes or [None] * len(bags)
    return [
        Keyframe(i, 10 * i, i * period_s, np.eye(4), b, s)
        for i, (b, s) in enumerate(zip(bags, scenes, strict=True))
    ]


# Four places in a row, then the same four again: each keyframe shares a word with the next.
TOUR = [bag(i, (i + 1) % 4) for i in (0, 1, 2, 3, 0, 1, 2, 3)]
PAPER = LoopParams(
    by="bags",
    lower_threshold=0.5,
    normaliser_lag_s=1.0,
    min_normaliser=0.1,
    tc=2,
    tc_required=0,
    max_index_difference=1,
    top_k=1,
    min_age_s=3.0,
    min_scene_agreement=0.0,
)


def find_all(params, frames):
    detector = make_loop_detector(params, N_WORDS)
    return [detector.find(keyframe, UNSEEN).candidates for keyframe in frames]


def changed(**changes):
    return PAPER.model_copy(update=changes)


def test_a_revisit_is_found_and_scored_as_in_the_paper():
    *_, candidates = find_all(PAPER, keyframes(TOUR))
    (candidate,) = candidates
    assert (candidate.query_id, candidate.match_id) == (7, 3)
    assert candidate.score == pytest.approx(1.0)
    assert candidate.normaliser == pytest.approx(0.5)  # shares one word of two with keyframe 6
    assert candidate.eta == pytest.approx(2.0)
    assert candidate.decision == ""


def test_recent_keyframes_are_no_loops():
    found = find_all(PAPER, keyframes([bag(0)] * 6))
    assert [[c.match_id for c in candidates] for candidates in found] == [
        [], [], [], [0], [0], [0],
    ]  # fmt: skip


def test_score_below_the_lower_threshold_is_discarded():
    *_, (candidate,) = find_all(changed(lower_threshold=2.5), keyframes(TOUR))
    assert candidate.decision == "rejected"
    assert candidate.reason == "eta 2.000 below 2.5"


def test_above_the_upper_threshold_is_accepted_unverified_and_between_left_open():
    *_, (accepted,) = find_all(changed(upper_threshold=1.9), keyframes(TOUR))
    assert accepted.decision == "accepted"
    assert accepted.reason == "eta 2.000 above 1.9: not verified"
    *_, (between,) = find_all(changed(upper_threshold=2.0), keyframes(TOUR))
    assert (between.decision, between.reason) == ("", "")


def test_the_upper_threshold_does_not_spare_time_consistency():
    params = changed(upper_threshold=0.5, tc_required=2, max_index_difference=2)
    decisions = [c.decision for found in find_all(params, keyframes(TOUR)) for c in found]
    assert decisions == ["rejected", "rejected", "accepted", "accepted", "accepted"]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        # Keyframes 3 to 7 have older ones to search. Their maxima have eta 1, 2, 2, 2, 2.
        ({}, LoopCounts(candidate=5, approved=5)),
        ({"lower_threshold": 1.5}, LoopCounts(candidate=4, approved=4, discarded=1)),
        ({"upper_threshold": 1.5}, LoopCounts(candidate=4, approved=4, between=1)),
        ({"upper_threshold": 2.0}, LoopCounts(between=5)),
        ({"min_normaliser": 0.6}, LoopCounts(unjudged=5)),
        ({"tc_required": 2, "max_index_difference": 2}, LoopCounts(candidate=5, approved=3)),
        ({"min_age_s": 60.0}, LoopCounts()),
    ],
)
def test_keyframes_are_counted_as_in_table_10(changes, expected):
    detector = make_loop_detector(changed(**changes), N_WORDS)
    for keyframe in keyframes(TOUR):
        detector.find(keyframe, UNSEEN)
    assert detector.counts == expected


def test_what_nothing_is_like_is_discarded():
    detector = make_loop_detector(PAPER, N_WORDS)
    for keyframe in keyframes([bag(i) for i in range(5)]):
        detector.find(keyframe, UNSEEN)
    assert detector.counts == LoopCounts(discarded=2)


def test_a_keyframe_with_two_candidates_counts_once():
    frames = keyframes([bag(0), bag(0, 1), bag(2), bag(2), bag(0), bag(5), bag(6), bag(0)])
    detector = make_loop_detector(
        changed(top_k=3, max_index_difference=1, min_normaliser=0.0), N_WORDS
    )
    for keyframe in frames:
        found = detector.find(keyframe, UNSEEN)
    assert len(found.candidates) == 2
    assert detector.counts == LoopCounts(candidate=2, approved=2, discarded=3)


def test_untrusted_normaliser_is_not_judged():
    *_, (candidate,) = find_all(changed(min_normaliser=0.6), keyframes(TOUR))
    assert candidate.decision == "rejected"
    assert "not judged" in candidate.reason


def test_time_consistency_wants_neighbours_to_agree():
    params = changed(tc_required=2, max_index_difference=2)
    frames = keyframes(TOUR)
    open_ids = [c.query_id for found in find_all(params, frames) for c in found if not c.decision]
    assert open_ids == [5, 6, 7]  # before 3 and 4 too few keyframes had a maximum at all


def test_contradicting_labels_reject_and_agreeing_ones_do_not():
    params = changed(min_scene_agreement=0.5)
    office_again = [scene(0.99)] * 4 + [scene(0.01)] * 4
    *_, (contradicted,) = find_all(params, keyframes(TOUR, office_again))
    assert contradicted.decision == "rejected"
    assert "scene labels contradict" in contradicted.reason
    *_, (agreed,) = find_all(params, keyframes(TOUR, [scene(0.9)] * 8))
    assert agreed.decision == ""


def test_top_k_candidates_are_apart_and_ordered():
    frames = keyframes([bag(0), bag(0, 1), bag(2), bag(2), bag(0), bag(5), bag(6), bag(0)])
    detector = make_loop_detector(
        changed(top_k=3, max_index_difference=1, min_normaliser=0.0), N_WORDS
    )
    *_, candidates = [detector.find(keyframe, UNSEEN).candidates for keyframe in frames]
    assert [c.match_id for c in candidates] == [0, 4]  # 1 stands beside 0; 2 and 3 score zero
    assert candidates[0].eta == np.inf  # nothing in common with one second ago


def test_empty_bags_find_nothing():
    assert find_all(PAPER, keyframes([bag()] * 6)) == [[]] * 6


@pytest.fixture(scope="module")
def rounds(look, standpoint):
    """Views once round the room, and the first four again from a little aside; one a second."""
    found = []
    for index in range(16):
        yaw = 2 * np.pi / 12 * index
        T = np.eye(4)
        T[:3, 0], T[:3, 1], T[:3, 2] = (
            [np.sin(yaw), -np.cos(yaw), 0], [0, 0, -1], [np.cos(yaw), np.sin(yaw), 0],
        )  # fmt: skip
        T[:3, 3] = [standpoint[0] + 0.1 * (index // 12), standpoint[1], 1.3]
        found.append((look(T, index), T))
    return found


def find_views(params, rounds):
    detector = make_loop_detector(params, N_WORDS)
    T_odom_world = se3.inverse(rounds[0][1])
    return [
        detector.find(Keyframe(i, i, float(i), T_odom_world @ T, bag(), None), frame)
        for i, (frame, T) in enumerate(rounds)
    ]


def test_views_are_found_again_and_where_they_are(rounds):
    params = LoopParams(max_index_difference=1, tc_required=0, top_k=2)
    found = find_views(params, rounds)
    assert not any(c for f in found[:3] for c in f.candidates)  # nothing is old enough
    for query in range(12, 16):
        best, *_ = found[query].candidates
        assert (best.query_id, best.match_id, best.source) == (query, query - 12, "view")
        assert (best.decision, np.isnan(best.eta)) == ("", True)
        T_match_query = se3.inverse(rounds[query - 12][1]) @ rounds[query][1]
        off = se3.inverse(T_match_query) @ found[query].guesses[best.match_id]
        assert np.linalg.norm(off[:3, 3]) < 0.05


def test_views_that_see_too_little_of_each_other_are_rejected(rounds):
    params = LoopParams(max_index_difference=1, min_inlier_ratio=0.99)
    (*_, last) = find_views(params, rounds)
    assert last.candidates
    for candidate in last.candidates:
        assert candidate.decision == "rejected"
        assert candidate.reason.startswith("both see 0.")


def test_views_are_held_to_time_consistency(rounds):
    params = LoopParams(max_index_difference=1, tc=2, tc_required=2, top_k=1, min_inlier_ratio=0.0)
    found = [f.candidates for f in find_views(params, rounds)]
    decisions = set()
    for query, candidates in enumerate(found):
        for candidate in candidates:
            agreeing = [
                any(abs(other.match_id - candidate.match_id) <= 1 for other in before)
                for before in found[max(0, query - 2) : query]
            ]
            assert candidate.n_consistent == sum(agreeing)
            assert candidate.decision == ("" if sum(agreeing) == 2 else "rejected")
            decisions.add(candidate.decision)
    assert decisions == {"", "rejected"}


@pytest.mark.parametrize(
    ("a", "b", "expected"),
    [
        (scene(0.7), scene(0.7), 1.0),
        (scene(1.0), scene(0.0), 0.0),
        (scene(0.5), None, 1.0),
        (scene(0.5), scene(1.0), np.sqrt(0.5)),
    ],
)
def test_scene_agreement(a, b, expected):
    assert scene_agreement(a, b) == pytest.approx(expected)
