from dataclasses import replace

import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import LevelledClassifier, levelled_features
from slam_bof.scenes.height_profile import FLOOR_SEEN, N_PROFILE_VALUES, SURFACE_SHARE
from slam_bof.scenes.levelled_classifier import Warming, _agreed, fit_certainty
from slam_bof.scenes.mlp_ensemble import MlpEnsemble
from slam_bof.scenes.shape_words import N_SHAPE_VALUES


def frames(seed, n=24):
    rng = np.random.default_rng(seed)
    for i in range(n):
        table_m = (0.45, 0.9)[i % 2] + rng.uniform(-0.04, 0.04)
        yield (
            table_frame(
                table_m=table_m, ahead_m=rng.uniform(1.8, 2.3), eye_m=rng.uniform(1.4, 1.6)
            ),
            ("bench", "counter")[i % 2],
        )


@pytest.fixture(scope="module")
def scenes():
    seen = list(frames(0))
    network = MlpEnsemble(n_hidden=16, n_networks=1, n_steps=200, n_folds=2)
    views, labels = (
        [levelled_features(frame, with_shapes=True) for frame, _ in seen],
        [label for _, label in seen],
    )
    return LevelledClassifier.fit(views, labels, n_words=30, network=network)


def test_unseen_views_are_labelled(scenes):
    labelled = [(scenes.label(frame), label) for frame, label in frames(1, n=10)]
    assert all(scene.label == label for scene, label in labelled)
    scene = labelled[0][0]
    assert scene.classes == ("bench", "counter")
    assert scene.probability == scene.probabilities.max()
    assert scene.probabilities.sum() == pytest.approx(1.0)


def test_words_can_be_left_out():
    views = [levelled_features(frame) for frame, _ in frames(0)]
    assert all(item.shapes.shape == (0, N_SHAPE_VALUES) for item in views)
    network = MlpEnsemble(n_hidden=16, n_networks=1, n_steps=200, n_folds=2)
    labels = [label for _, label in frames(0)]
    fitted = LevelledClassifier.fit(views, labels, network=network)
    again = LevelledClassifier.from_arrays(fitted.manifest(), fitted.arrays())
    assert "words" not in fitted.arrays()
    for frame, label in frames(1, n=6):
        scene = fitted.label(frame)
        assert scene.label == label
        np.testing.assert_array_equal(again.label(frame).probabilities, scene.probabilities)


def test_nothing_seen_is_labelled_too(scenes):
    assert np.isfinite(scenes.label(empty_frame()).probabilities).all()


def test_a_classifier_is_restored_from_its_description_and_arrays(scenes):
    again = LevelledClassifier.from_arrays(scenes.manifest(), scenes.arrays())
    frame, _ = next(frames(2))
    np.testing.assert_array_equal(
        again.label(frame).probabilities, scenes.label(frame).probabilities
    )
    assert again.manifest() == scenes.manifest()


@pytest.mark.parametrize("name", ["words", "temperature", "mean", "hidden", "out_bias"])
def test_arrays_that_do_not_fit_are_refused(scenes, name):
    arrays = scenes.arrays()
    with pytest.raises(ValueError, match="levels/"):
        LevelledClassifier.from_arrays(scenes.manifest(), arrays | {name: np.zeros((3, 3, 3))})
    del arrays[name]
    with pytest.raises(KeyError):
        LevelledClassifier.from_arrays(scenes.manifest(), arrays)


@pytest.mark.parametrize(
    ("name", "value", "warming"),
    [(FLOOR_SEEN, 0.0, Warming(assumed_floor=2.0)), (SURFACE_SHARE, 0.5, Warming(empty_view=4.0))],
)
def test_a_label_is_less_certain_where_a_view_says_less(scenes, name, value, warming):
    careful = replace(scenes, warming=warming)
    seen = levelled_features(next(frames(2))[0])
    whole = replace(seen, profile=seen.profile.copy())
    whole.profile[[FLOOR_SEEN, SURFACE_SHARE]] = 1.0
    assert careful.label_features(whole).probability == scenes.label_features(whole).probability
    whole.profile[name] = value
    p, q = (c.label_features(whole).probabilities for c in (scenes, careful))
    np.testing.assert_allclose(q, np.sqrt(p) / np.sqrt(p).sum())
    again = type(careful).from_arrays(careful.manifest(), careful.arrays())
    assert again.warming == warming
    for array in set(careful.arrays()) - set(scenes.arrays()):
        with pytest.raises(ValueError, match=rf"{array} must be a number, 1 to"):
            type(careful).from_arrays(careful.manifest(), careful.arrays() | {array: np.array(0.5)})


def test_both_heights_count_where_two_are_possible(scenes):
    low, other = (levelled_features(frame) for frame, _ in list(frames(2))[:2])
    p, q = (scenes.label_features(item).probabilities for item in (low, other))
    agreed = scenes.label_features(replace(low, otherwise=other)).probabilities
    both = np.sqrt(p * q)
    np.testing.assert_allclose(agreed, both + (1.0 - both.sum()) / len(p))
    assert agreed.sum() == pytest.approx(1.0)
    same = scenes.label_features(replace(low, otherwise=low)).probabilities
    np.testing.assert_allclose(same, p)
    near = levelled_features(table_frame(eye_m=0.5, pitch=0.5, ahead_m=6.0))
    assert near.profile[FLOOR_SEEN] == 0.0
    assert near.otherwise.profile[FLOOR_SEEN] == 1.0
    assert near.otherwise.profile[FLOOR_SEEN - 1] == pytest.approx(0.5, abs=0.03)


def test_repeated_views_are_not_certain_of_what_only_one_height_says():
    # A counter if the camera is high, a bare floor, which says nothing, if it is low.
    high = np.array([0.70, *[0.0375] * 8])
    low = np.array([0.04, *[0.12] * 8])
    agreed, mean = _agreed(high, low), (high + low) / 2
    assert agreed.argmax() == 0
    pooled = [p**2.5 / (p**2.5).sum() for p in (agreed, mean)]
    assert pooled[0].max() < 0.5 < pooled[1].max()
    np.testing.assert_allclose(_agreed(np.eye(2)[0], np.eye(2)[1]), 0.5)


def profiles(n, floor_seen=1.0, surface_share=1.0):
    found = np.zeros((n, N_PROFILE_VALUES))
    found[:, FLOOR_SEEN], found[:, SURFACE_SHARE] = floor_seen, surface_share
    return found


def test_certainty_is_what_frames_held_out_bear():
    rng = np.random.default_rng(0)
    index, assumed = rng.integers(0, 3, 4000), np.arange(4000) % 2 == 1
    logits = 4.0 * np.eye(3, dtype=np.float32)[index]
    # Of the labels 80 % are right where the floor is seen, 50 % where it is not.
    wrong = rng.random(4000) < np.where(assumed, 0.5, 0.2)
    truth = np.where(wrong, (index + 1) % 3, index)
    temperature, warming = fit_certainty(logits, truth, profiles(4000, ~assumed), np.ones(4000))
    for factor, share in ((1.0, 0.8), (warming.assumed_floor, 0.5)):
        p = np.exp(4.0 / (temperature * factor))
        assert p / (p + 2.0) == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize("n_right", [300, 600, 900])
def test_labels_are_as_probable_as_they_are_right(n_right):
    """Logits that are sure of half of the wrong labels mislead the cross entropy, not the mean."""
    rng = np.random.default_rng(0)
    answer = rng.integers(0, 5, 1000)
    logits = np.where(np.arange(1000) % 2, 9.0, 1.0)[:, None] * np.eye(5)[answer]
    truth = np.where(np.arange(1000) < n_right, answer, (answer + 1) % 5)
    temperature, _ = fit_certainty(logits.astype(np.float32), truth, profiles(1000), np.ones(1000))
    p = np.exp(logits / temperature)
    assert (p.max(axis=1) / p.sum(axis=1)).mean() == pytest.approx(n_right / 1000, abs=1e-3)


def test_certainty_has_no_more_digits_than_it_is_known_to():
    rng = np.random.default_rng(0)
    logits, truth = rng.normal(size=(500, 4)).astype(np.float32), rng.integers(0, 4, 500)
    temperature, warming = fit_certainty(
        logits, truth, profiles(500, rng.random(500)), np.ones(500)
    )
    for value in (temperature, warming.assumed_floor, warming.empty_view):
        assert value == float(f"{value:.4g}")


def test_scenes_of_no_class_lower_the_certainty_of_views_like_theirs_alone():
    rng = np.random.default_rng(0)
    index = rng.integers(0, 3, 900)
    logits = 4.0 * np.eye(3, dtype=np.float32)[index]
    # Of the first 600, which show a class, 80 % are right; the others show none, with holes.
    truth = np.where(rng.random(900) < 0.2, (index + 1) % 3, index)[:600]
    shares = np.where(np.arange(900) < 600, 1.0, 0.5)
    temperature, warming = fit_certainty(
        logits, truth, profiles(900, surface_share=shares), np.ones(900)
    )
    for share, right in ((1.0, 0.8), (0.5, 0.34)):
        p = np.exp(4.0 / (temperature * warming.empty_view ** (1.0 - share)))
        assert p / (p + 2.0) == pytest.approx(right, abs=0.1)
