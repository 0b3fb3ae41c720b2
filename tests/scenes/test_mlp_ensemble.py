import numpy as np
import pytest
from scipy.special import log_softmax
from sklearn.neural_network import MLPClassifier
from sklearn.utils.estimator_checks import parametrize_with_checks

from slam_bof.scenes.mlp_ensemble import LEARNING_RATE, MlpEnsemble


@parametrize_with_checks([MlpEnsemble(n_hidden=64, n_networks=1, n_steps=600, n_folds=2)])
def test_estimators_keep_scikit_learns_rules(estimator, check):
    check(estimator)


def views(seed, n=400, n_classes=3, spread=1.5):
    rng = np.random.default_rng(seed)
    index = np.arange(n) % n_classes
    centres = np.random.default_rng(9).standard_normal((n_classes, 8))
    X = centres[index] + spread * rng.standard_normal((n, 8))
    return X.astype(np.float32), np.array(["bath", "kitchen", "office"])[index], np.arange(n) // 9


@pytest.fixture(scope="module")
def network():
    return MlpEnsemble(n_hidden=16, n_steps=300, n_networks=1).fit(*views(0))


def test_classes_are_separated_with_calibrated_probabilities(network):
    X, truth, _ = views(1, n=3000)
    p = network.predict_proba(X)
    right = network.classes_[p.argmax(axis=1)] == truth
    assert right.mean() > 0.7
    assert abs(p.max(axis=1).mean() - right.mean()) < 0.05


def test_overconfidence_is_taken_back():
    # Nothing to learn: who learns it by heart must still not believe it.
    rng = np.random.default_rng(0)
    X, y = rng.standard_normal((200, 30)).astype(np.float32), np.arange(200) % 2
    network = MlpEnsemble(n_networks=1, decay=0.0, n_steps=600).fit(X, y)
    unseen = rng.standard_normal((500, 30)).astype(np.float32)
    assert network.temperature_ > 3
    assert network.predict_proba(unseen).max(axis=1).mean() < 0.75


def test_a_few_moments_allow_no_more_certainty_than_their_number():
    # Plain to tell apart, but only 6 stretches have been seen.
    X, y, _ = views(0, spread=0.05)
    groups = np.char.add(y, (np.arange(len(y)) >= len(y) // 2).astype(str))
    sure, careful = (
        MlpEnsemble(n_hidden=16, n_networks=1, n_steps=300).fit(X, y, groups, n_groups=n)
        for n in (None, 6)
    )
    np.testing.assert_array_equal(careful.hidden_, sure.hidden_)
    assert sure.predict_proba(X).max(axis=1).mean() > 0.99
    assert careful.predict_proba(X).max(axis=1).mean() == pytest.approx(7 / 8, abs=0.03)


@pytest.mark.parametrize("n_classes", [2, 3])
def test_the_arrays_answer_as_scikit_learns_network(n_classes):
    X, y, _ = views(0, n_classes=n_classes)
    network = MlpEnsemble(n_hidden=16, n_networks=1, n_steps=100, seed=4).fit(X, y)
    inputs = np.clip((X - network.mean_) / network.scale_, -4, 4)
    theirs = MLPClassifier(
        (16,),
        alpha=network.decay * 200,
        batch_size=200,
        learning_rate_init=LEARNING_RATE,
        max_iter=50,
        n_iter_no_change=50,
        random_state=4,
    )
    with pytest.warns(match="Maximum iterations"):
        theirs.fit(inputs, y)
    expected = log_softmax(theirs.predict_log_proba(inputs) / network.temperature_, axis=1)
    np.testing.assert_allclose(network.predict_proba(X), np.exp(expected), atol=1e-4)


def test_the_same_seed_gives_the_same_arrays(network):
    again = MlpEnsemble(n_hidden=16, n_steps=300, n_networks=1).fit(*views(0))
    np.testing.assert_array_equal(again.hidden_, network.hidden_)
    assert again.temperature_ == network.temperature_
    other = MlpEnsemble(n_hidden=16, n_steps=300, n_networks=1, seed=1).fit(*views(0))
    assert not np.array_equal(other.hidden_, network.hidden_)


def test_a_class_in_one_sequence_only_can_be_learnt():
    X, y, _ = views(0)
    network = MlpEnsemble(n_hidden=8, n_steps=100).fit(X, y, groups=y)
    assert network.classes_.tolist() == ["bath", "kitchen", "office"]


def test_one_class_is_refused():
    X, _, _ = views(0)
    with pytest.raises(ValueError, match=r"at least 2 classes .* got 1 class \(a: 400\)"):
        MlpEnsemble().fit(X, ["a"] * len(X))
