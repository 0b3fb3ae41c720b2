from dataclasses import replace

import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import LevelledClassifier, levelled_features
from slam_bof.scenes.height_profile import FLOOR_SEEN
from slam_bof.scenes.levelled_classifier import fit_certainty
from slam_bof.scenes.mlp_ensemble import MlpEnsemble


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
    views, labels = [levelled_features(frame) for frame, _ in seen], [label for _, label in seen]
    return LevelledClassifier.fit(views, labels, n_words=30, network=network)


def test_unseen_views_are_labelled(scenes):
    labelled = [(scenes.label(frame), label) for frame, label in frames(1, n=10)]
    assert all(scene.label == label for scene, label in labelled)
    scene = labelled[0][0]
    assert scene.classes == ("bench", "counter")
    assert scene.probability == scene.probabilities.max()
    assert scene.probabilities.sum() == pytest.approx(1.0)


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


def test_a_label_is_less_certain_where_the_floor_is_assumed(scenes):
    careful = replace(scenes, assumed_floor_warming=2.0)
    seen = levelled_features(next(frames(2))[0])
    assert seen.profile[FLOOR_SEEN] == 1.0
    assert careful.label_features(seen).probability == scenes.label_features(seen).probability
    unseen = replace(seen, profile=seen.profile.copy())
    unseen.profile[FLOOR_SEEN] = 0.0
    p, q = (c.label_features(unseen).probabilities for c in (scenes, careful))
    np.testing.assert_allclose(q, np.sqrt(p) / np.sqrt(p).sum())
    again = type(careful).from_arrays(careful.manifest(), careful.arrays())
    assert again.assumed_floor_warming == 2.0
    with pytest.raises(ValueError, match="assumed_floor_warming must be a number, 1 to 4"):
        type(careful).from_arrays(
            careful.manifest(), careful.arrays() | {"assumed_floor_warming": np.array(0.5)}
        )


def test_both_heights_count_where_two_are_possible(scenes):
    low, other = (levelled_features(frame) for frame, _ in list(frames(2))[:2])
    p, q = (scenes.label_features(item).probabilities for item in (low, other))
    mean = scenes.label_features(replace(low, otherwise=other)).probabilities
    np.testing.assert_allclose(mean, (p + q) / 2)
    near = levelled_features(table_frame(eye_m=0.5, pitch=0.5, ahead_m=6.0))
    assert near.profile[FLOOR_SEEN] == 0.0
    assert near.otherwise.profile[FLOOR_SEEN] == 1.0
    assert near.otherwise.profile[FLOOR_SEEN - 1] == pytest.approx(0.5, abs=0.03)


def test_certainty_is_what_frames_held_out_bear():
    rng = np.random.default_rng(0)
    index, assumed = rng.integers(0, 3, 4000), np.arange(4000) % 2 == 1
    logits = 4.0 * np.eye(3, dtype=np.float32)[index]
    # Of the labels 80 % are right where the floor is seen, 50 % where it is not.
    wrong = rng.random(4000) < np.where(assumed, 0.5, 0.2)
    truth = np.where(wrong, (index + 1) % 3, index)
    temperature, warming = fit_certainty(logits, truth, assumed, np.ones(4000))
    for factor, share in ((1.0, 0.8), (warming, 0.5)):
        p = np.exp(4.0 / (temperature * factor))
        assert p / (p + 2.0) == pytest.approx(share, abs=0.03)


def test_scenes_of_no_class_lower_the_certainty():
    logits = 4.0 * np.eye(3, dtype=np.float32)[np.arange(300) % 3]
    seen = np.zeros(300, bool)
    alone, _ = fit_certainty(logits[:200], np.arange(200) % 3, seen[:200], np.ones(200))
    together, _ = fit_certainty(logits, np.arange(200) % 3, seen, np.ones(300))
    assert together > 2.0 * alone
