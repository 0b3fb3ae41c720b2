import warnings

import numpy as np
import pytest
from scipy import sparse
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV
from sklearn.pipeline import make_pipeline
from sklearn.utils.estimator_checks import parametrize_with_checks

from slam_bof.bof import TfIdf
from slam_bof.scenes import SceneClassifier
from slam_bof.types import Bag

N_WORDS = 60


@parametrize_with_checks([SceneClassifier(n_folds=2), SceneClassifier(kernel="rbf", n_folds=2)])
def test_estimators_keep_scikit_learns_rules(estimator, check):
    check(estimator)


def rooms(seed, n_frames=240):
    """Return bags of three scenes that prefer different words, labels, and sequences."""
    rng = np.random.default_rng(seed)
    labels = np.array(["bath", "kitchen", "office"])[np.arange(n_frames) % 3]
    preference = np.kron(np.eye(3), np.full(N_WORDS // 3, 2.0)) + 1.0
    rates = preference[np.arange(n_frames) % 3] / 6
    bags = rng.poisson(rates).astype(float) + 1e-9
    return bags / bags.sum(axis=1, keepdims=True), labels, np.arange(n_frames) // 12


@pytest.mark.parametrize("kernel", ["linear", "rbf"])
def test_scenes_are_told_apart(kernel):
    bags, labels, groups = rooms(0)
    scenes = SceneClassifier(kernel=kernel).fit(bags, labels, groups)
    unseen, truth, _ = rooms(1)
    assert (scenes.predict(unseen) == truth).mean() > 0.85
    np.testing.assert_allclose(scenes.predict_proba(unseen).sum(axis=1), 1.0)


def test_probabilities_are_calibrated():
    bags, labels, groups = rooms(0, 600)
    unseen, truth, _ = rooms(1, 600)
    scenes = SceneClassifier().fit(bags, labels, groups)
    confidence = scenes.predict_proba(unseen).max(axis=1)
    accuracy = (scenes.predict(unseen) == truth).mean()
    assert confidence.mean() == pytest.approx(accuracy, abs=0.08)


@pytest.mark.parametrize("kernel", ["linear", "rbf"])
def test_one_bag_is_predicted_as_many(kernel):
    bags, labels, _ = rooms(0)
    scenes = SceneClassifier(kernel=kernel).fit(sparse.csr_array(bags), labels)
    words = np.flatnonzero(bags[4] > 1e-6).astype(np.int32)
    weights = (bags[4, words] / bags[4, words].sum()).astype(np.float32)
    row = np.zeros((1, N_WORDS))
    row[0, words] = weights
    scene = scenes.predict_bag(Bag(words, weights))
    assert scene.classes == ("bath", "kitchen", "office")
    assert scene.label == scenes.predict(row)[0] == "kitchen"
    np.testing.assert_allclose(scene.probabilities, scenes.predict_proba(row)[0], atol=1e-6)
    assert scene.probability == scene.probabilities.max()


def test_one_bag_of_two_classes_is_predicted_as_many():
    bags, labels, _ = rooms(0)
    two = labels != "office"
    scenes = SceneClassifier().fit(bags[two], labels[two])
    scene = scenes.predict_bag(Bag(np.arange(N_WORDS, dtype=np.int32), bags[3].astype(np.float32)))
    expected = scenes.predict_proba(bags[3:4].astype(np.float32))[0]
    np.testing.assert_allclose(scene.probabilities, expected, atol=1e-6)


def test_an_empty_bag_gets_probabilities_too():
    bags, labels, _ = rooms(0)
    scene = (
        SceneClassifier()
        .fit(bags, labels)
        .predict_bag(Bag(np.empty(0, np.int32), np.empty(0, np.float32)))
    )
    assert scene.probabilities.sum() == pytest.approx(1.0)


def test_the_same_seed_gives_the_same_probabilities():
    bags, labels, groups = rooms(0)
    first = SceneClassifier(seed=3).fit(bags, labels, groups)
    again = clone(first).fit(bags, labels, groups)
    np.testing.assert_array_equal(first.predict_proba(bags), again.predict_proba(bags))


def test_a_scene_of_one_sequence_can_be_learnt():
    bags, labels, _ = rooms(0)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        scenes = SceneClassifier().fit(bags, labels, groups=labels)
    assert (scenes.predict(bags) == labels).mean() > 0.9


@pytest.mark.parametrize("labels", [["a"] * 6, ["a"] * 5 + ["b"]])
def test_too_few_classes_or_samples_are_refused(labels):
    bags, _, _ = rooms(0, 6)
    with pytest.raises(ValueError, match="at least 2 classes of at least 2 samples each, got"):
        SceneClassifier().fit(bags, labels)


def test_weights_and_classifier_make_a_pipeline():
    bags, labels, _ = rooms(0)
    counts = np.round(1000 * bags)
    pipeline = make_pipeline(TfIdf(), SceneClassifier(n_folds=3))
    fitted = clone(pipeline).fit(counts[:180], labels[:180])
    assert fitted.score(counts[180:], labels[180:]) > 0.8
    search = GridSearchCV(pipeline, {"sceneclassifier__C": [0.1, 1.0]}, cv=3)
    search.fit(counts[:180], labels[:180])
    assert search.best_params_["sceneclassifier__C"] in (0.1, 1.0)
