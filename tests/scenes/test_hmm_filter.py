"""The hidden Markov model over scene labels, against brute force over all sequences of rooms."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from slam_bof.scenes import UNKNOWN_LABEL, SceneFilter, SceneFilterParams
from slam_bof.scenes.hmm_filter import most_probable_scene
from slam_bof.scenes.hmm_smoother import place_evidence, smooth
from slam_bof.types import Scene

CLASSES = ("bath", "kitchen", "office")
PARAMS = SceneFilterParams(
    mean_stay_s=20.0,
    mean_stay_m=4.0,
    evidence_exponent=0.7,
    smoothing_evidence_exponent=0.7,
    min_probability=0.0,
)


def scenes_of(probabilities: np.ndarray) -> list[Scene]:
    return [Scene(CLASSES[p.argmax()], p.max(), CLASSES, p) for p in probabilities]


@pytest.fixture
def walk() -> tuple[list[Scene], np.ndarray, np.ndarray]:
    """Five keyframes at uneven times and places."""
    rng = np.random.default_rng(3)
    stamps_s = np.cumsum(rng.uniform(0.1, 4.0, 5))
    positions_m = np.cumsum(rng.normal(0.0, 0.7, (5, 3)), axis=0)
    return scenes_of(rng.dirichlet(np.ones(3), 5)), stamps_s, positions_m


def posterior(walk, n: int) -> np.ndarray:
    """P(room of keyframe k | keyframes 0 ... n - 1), by adding up all paths through rooms."""
    scenes, stamps_s, positions_m = walk
    total = np.zeros((n, 3))
    for path in itertools.product(range(3), repeat=n):
        chance = 1.0
        for k, room in enumerate(path):
            chance *= scenes[k].probabilities[room] ** PARAMS.evidence_exponent
            if k:
                metres = np.linalg.norm(positions_m[k] - positions_m[k - 1])
                rooms = (
                    stamps_s[k] - stamps_s[k - 1]
                ) / PARAMS.mean_stay_s + metres / PARAMS.mean_stay_m
                chance *= np.exp(-rooms) if room == path[k - 1] else (1 - np.exp(-rooms)) / 2
        for k, room in enumerate(path):
            total[k, room] += chance
    return total / total.sum(axis=1, keepdims=True)


def test_the_filter_is_the_posterior_of_all_so_far(walk):
    scenes, stamps_s, positions_m = walk
    filter_ = SceneFilter(PARAMS)
    for k, arguments in enumerate(zip(scenes, stamps_s, positions_m, strict=True)):
        found = filter_.update(*arguments).probabilities
        np.testing.assert_allclose(found, posterior(walk, k + 1)[k], atol=1e-12)


def test_smoothing_is_the_posterior_of_all(walk):
    found = [scene.probabilities for scene in smooth(*walk, PARAMS)]
    np.testing.assert_allclose(found, posterior(walk, 5), atol=1e-12)


def test_of_the_last_keyframe_both_say_the_same(walk):
    filter_ = SceneFilter(PARAMS)
    *_, live = (filter_.update(*arguments) for arguments in zip(*walk, strict=True))
    np.testing.assert_allclose(live.probabilities, smooth(*walk, PARAMS)[-1].probabilities)


def test_a_single_wrong_label_is_corrected_and_a_change_is_kept():
    p = np.array([0.7, 0.2, 0.1])
    bath, kitchen = p, p[[1, 0, 2]]
    scenes = scenes_of(np.array([bath] * 4 + [kitchen] + [bath] * 4 + [kitchen] * 9))
    n = len(scenes)
    found = smooth(
        scenes,
        np.arange(n) / 2,
        np.zeros((n, 3)),
        SceneFilterParams(smoothing_evidence_exponent=0.8),
    )
    assert [scene.label for scene in found] == ["bath"] * 9 + ["kitchen"] * 9


def test_far_away_is_another_room_and_an_unknown_way_is_none():
    p = np.array([0.8, 0.1, 0.1])
    one, two = scenes_of(np.array([p, np.full(3, 1 / 3)]))

    def after(x_m: float, *, segment: int = 0) -> float:
        filter_ = SceneFilter(PARAMS)
        filter_.update(one, 0.0, (0, 0, 0))
        return float(filter_.update(two, 0.1, (x_m, 0, 0), segment=segment).probabilities[0])

    assert after(0.0) > after(1.0) > after(100.0)
    assert after(100.0, segment=1) == after(0.0)
    far = np.array([[0, 0, 0], [100.0, 0, 0]])
    whole = smooth([one, two], [0.0, 0.1], far, PARAMS, segments=[0, 1])
    assert whole[1].probabilities[0] == pytest.approx(after(0.0))


def test_sessions_and_components_know_nothing_of_each_other(walk):
    scenes, stamps_s, positions_m = walk
    axes = np.tile([0.0, 0.0, 1.0], (5, 1))
    apart = {"sessions": [0, 0, 1, 1, 1], "components": [0, 0, 1, 1, 1]}
    whole = smooth(scenes, stamps_s, positions_m, PARAMS, axes=axes, **apart)
    for part in (slice(0, 2), slice(2, 5)):
        alone = smooth(scenes[part], stamps_s[part], positions_m[part], PARAMS, axes=axes[part])
        for one, other in zip(whole[part], alone, strict=True):
            np.testing.assert_allclose(one.probabilities, other.probabilities, atol=1e-12)


def test_evidence_goes_where_one_looks_and_none_is_lost():
    rng = np.random.default_rng(5)
    logs, positions_m = rng.normal(size=(40, 3)), rng.uniform(0.0, 3.0, (40, 3))
    positions_m[7] = np.nan
    looks_m = positions_m + np.array([0.0, 1.0, 0.0])
    components = np.arange(40) % 2
    placed = place_evidence(logs, looks_m, positions_m, components, 0.3)
    for part in (0, 1):
        np.testing.assert_allclose(
            placed[components == part].sum(axis=0), logs[components == part].sum(0)
        )
    np.testing.assert_array_equal(placed[7], logs[7])
    # A narrow spread is the nearest one.
    ids = np.flatnonzero((components == 0) & np.isfinite(positions_m[:, 0]))
    distances_m = np.linalg.norm(looks_m[ids, None] - positions_m[None, ids], axis=2)
    expected = np.zeros_like(logs)
    np.add.at(expected, ids[distances_m.argmin(axis=1)], logs[ids])
    narrow = place_evidence(logs, looks_m, positions_m, components, 1e-3)
    np.testing.assert_allclose(narrow[ids], expected[ids], atol=1e-9)


def test_looking_through_the_door_is_not_yet_to_be_there():
    # There and back along x, the door at 3 m; what is seen is 1 m ahead of the camera.
    x_m = np.concatenate([np.arange(0.0, 6.0, 0.15), np.arange(6.0, 0.0, -0.15)])
    ahead = np.where(np.arange(len(x_m)) < len(x_m) // 2, 1.0, -1.0)
    p = np.array([0.1, 0.7, 0.2])
    office, kitchen = p[[0, 2, 1]], p
    scenes = scenes_of(np.where((x_m + ahead)[:, None] < 3.0, office, kitchen))
    positions_m, axes = np.zeros((2, len(x_m), 3))
    positions_m[:, 0], axes[:, 0] = x_m, ahead
    true = np.where(x_m < 3.0, "office", "kitchen")
    stamps_s, params = np.arange(len(x_m)) / 5, SceneFilterParams()

    def right(found: list[Scene]) -> float:
        return float(
            np.mean([scene.label == name for scene, name in zip(found, true, strict=True)])
        )

    filter_ = SceneFilter(params)
    live = [filter_.update(*one) for one in zip(scenes, stamps_s, positions_m, strict=True)]
    early = smooth(scenes, stamps_s, positions_m, params)
    assert right(early) < 0.9
    assert right(smooth(scenes, stamps_s, positions_m, params, axes=axes)) >= max(0.97, right(live))


def test_too_little_is_unknown():
    p = np.array([0.5, 0.3, 0.2])
    assert most_probable_scene(p, CLASSES, 0.5).label == "bath"
    scene = most_probable_scene(p, CLASSES, 0.51)
    assert (scene.label, scene.probability) == (UNKNOWN_LABEL, 0.5)


def test_a_certain_classifier_does_not_break_it():
    scenes = scenes_of(np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]] * 50))
    found = smooth(scenes, np.arange(150) / 30, np.zeros((150, 3)), PARAMS)
    assert all(np.isfinite(scene.probabilities).all() for scene in found)
    # All at one place, at one time, of two minds.
    torn = [Scene(s.label, 1.0, CLASSES, s.probabilities) for s in scenes] * 20
    still = (np.zeros(len(torn)), np.zeros((len(torn), 3)), PARAMS)
    found = smooth(torn, *still, axes=np.zeros((len(torn), 3)))
    assert all(np.isfinite(scene.probabilities).all() for scene in found)


def test_no_keyframes_no_labels():
    assert smooth([], [], np.empty((0, 3)), PARAMS) == []


def test_one_class_stays():
    scene = Scene("office", 1.0, ("office",), np.ones(1))
    found = smooth([scene, scene], [0.0, 1.0], np.zeros((2, 3)), PARAMS)
    assert [(s.label, s.probability) for s in found] == [("office", 1.0)] * 2
