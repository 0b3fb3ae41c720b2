from __future__ import annotations

import numpy as np
import pytest
from scipy import sparse
from test_bag_classifier import N_WORDS, rooms

from slam_bof.scenes import (
    CLASSIFIERS,
    SceneClassifier,
    classifier_bytes,
    make_classifier,
    make_folds,
    search_svm,
)
from slam_bof.scenes.stored_classifier import load_classifier
from slam_bof.types import Bag


@pytest.mark.parametrize("name", CLASSIFIERS)
def test_every_classifier_tells_scenes_apart_and_goes_into_a_file(name: str) -> None:
    bags, labels, groups = rooms(0, 120)
    scenes = SceneClassifier(classifier=name, n_folds=3)
    scenes.fit(sparse.csr_array(bags), labels, groups)
    unseen, truth, _ = rooms(1, 120)
    assert (scenes.predict(unseen) == truth).mean() > 0.7
    again = load_classifier(classifier_bytes(scenes), N_WORDS)
    np.testing.assert_array_equal(again.predict_proba(unseen), scenes.predict_proba(unseen))
    words = np.flatnonzero(bags[4] > 1e-6).astype(np.int32)
    weights = bags[4, words].astype(np.float32)
    row = np.zeros((1, N_WORDS))
    row[0, words] = weights
    np.testing.assert_allclose(
        scenes.predict_bag(Bag(words, weights)).probabilities,
        scenes.predict_proba(row)[0],
        rtol=1e-4,
    )


def test_the_same_seed_gives_the_same_bytes() -> None:
    bags, labels, _ = rooms(0, 60)
    one, two = (
        classifier_bytes(SceneClassifier(classifier="mlp", n_folds=2).fit(bags, labels))
        for _ in range(2)
    )
    assert one == two


def test_the_search_finds_what_is_best_by_cross_validation() -> None:
    """A ring around a blob: no line can part them, a Gaussian kernel can."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, 120)
    radius = np.where(np.arange(120) % 2, 0.05, 0.4)
    X = 0.5 + (radius * np.stack([np.cos(angle), np.sin(angle)])).T
    y = np.array(["blob", "ring"])[(radius > 0.2).astype(int)]
    folds = make_folds(y, None, 5, 0)
    best, tried = search_svm(X, y, folds)
    assert best.name == "svm-rbf"
    assert best.accuracy > 0.95
    assert best.accuracy == max(one.accuracy for one in tried)
    assert {one.name for one in tried} == {"svm-linear", "svm-rbf"}
    assert max(one.accuracy for one in tried if one.name == "svm-linear") < 0.8


def test_of_equals_the_simplest() -> None:
    bags, labels, groups = rooms(0, 120)
    easy = np.eye(3)[np.unique(labels, return_inverse=True)[1]] + 0 * bags[:, :1]
    best, _ = search_svm(easy, labels, make_folds(labels, groups, 5, 0))
    assert (best.name, best.accuracy) == ("svm-linear", 1.0)


def test_an_unknown_classifier_is_refused() -> None:
    with pytest.raises(ValueError, match=r"name must be one of svm-linear, .*, got 'oracle'"):
        make_classifier("oracle")
