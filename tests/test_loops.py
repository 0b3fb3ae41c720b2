import numpy as np
import pytest

from slam_bof.loops import LoopDetector, LoopParams, scene_agreement
from slam_bof.types import Bag, Keyframe, Scene

N_WORDS = 8
CLASSES = ("kitchen", "office")


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
    detector = LoopDetector(params, N_WORDS)
    return [detector.find(keyframe) for keyframe in frames]


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
    detector = LoopDetector(changed(top_k=3, max_index_difference=1, min_normaliser=0.0), N_WORDS)
    *_, candidates = [detector.find(keyframe) for keyframe in frames]
    assert [c.match_id for c in candidates] == [0, 4]  # 1 stands beside 0; 2 and 3 score zero
    assert candidates[0].eta == np.inf  # nothing in common with one second ago


def test_empty_bags_find_nothing():
    assert find_all(PAPER, keyframes([bag()] * 6)) == [[]] * 6


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
