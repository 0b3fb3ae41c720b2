import numpy as np
import pytest
from test_mlp_ensemble import views

from slam_bof.scenes.continued_training import continue_network
from slam_bof.scenes.mlp_ensemble import MlpEnsemble


@pytest.fixture(scope="module")
def network() -> MlpEnsemble:
    X, y, _ = views(0, spread=1.0)
    return MlpEnsemble(n_hidden=32, n_steps=300, n_networks=1).fit(X, y)


def halls(seed: int, n: int) -> np.ndarray:
    """Samples of a fourth class."""
    rng = np.random.default_rng(seed)
    centre = np.random.default_rng(4).standard_normal(8)
    return (2.0 * centre + rng.standard_normal((n, 8))).astype(np.float32)


def recall(network: MlpEnsemble, X: np.ndarray, y: np.ndarray) -> float:
    return float((network.predict(X) == y).mean())


def test_a_new_class_is_learnt_and_the_old_ones_are_kept(network: MlpEnsemble) -> None:
    X, y, _ = views(1, n=1000, spread=1.0)
    before = recall(network, X, y)
    continued = continue_network(network, halls(0, 40), np.full(40, "hall"), None)
    assert continued.classes_.tolist() == ["bath", "hall", "kitchen", "office"]
    assert recall(continued, halls(1, 500), np.full(500, "hall")) > 0.8
    assert recall(continued, X, y) > before - 0.1
    assert network.classes_.tolist() == ["bath", "kitchen", "office"]
    assert recall(network, X, y) == before


def test_an_old_class_is_learnt_in_a_new_guise(network: MlpEnsemble) -> None:
    unseen, label = halls(1, 500), np.full(500, "bath")
    continued = continue_network(network, halls(0, 40), np.full(40, "bath"), None)
    assert continued.classes_.tolist() == network.classes_.tolist()
    assert recall(continued, unseen, label) > max(0.8, recall(network, unseen, label))


def test_weights_count_and_samples_decide_alone(network: MlpEnsemble) -> None:
    X = halls(0, 40)
    y = np.where(np.arange(40) < 20, "bath", "hall")
    by_halls = continue_network(network, X, y, np.arange(40) >= 20)
    assert recall(by_halls, X, np.full(40, "hall")) > 0.9
    again = continue_network(network, X, y, np.arange(40) >= 20)
    assert again.out_.tobytes() == by_halls.out_.tobytes()
