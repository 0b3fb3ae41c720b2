"""Set transformers: what they compute with NumPy, what PyTorch trains, and what files hold."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame
from set_transformers import random_classifier, random_network
from test_model import train

from slam_bof.errors import ModelError, PluginError
from slam_bof.scenes import (
    ConstellationClassifier,
    TransformerTraining,
    label_frame,
    levelled_features,
    model as models,
)
from slam_bof.scenes.set_transformer import SetTransformer, TransformerShape
from slam_bof.scenes.set_transformer_training import (
    fit_transformer,
    import_torch,
    transformer_logits,
)

SMALL = TransformerShape(n_profile=3, n_token=5, n_classes=2, n_networks=2, width=8, max_tokens=6)


def random_views(n: int, shape: TransformerShape, seed: int = 0):
    rng = np.random.default_rng(seed)
    return [
        (
            rng.standard_normal(shape.n_profile, np.float32),
            rng.standard_normal((k % (shape.max_tokens + 3), shape.n_token), np.float32),
        )
        for k in range(n)
    ]


@pytest.fixture(scope="module")
def torch():
    return pytest.importorskip("torch", reason="PyTorch (extra train) is not installed")


@pytest.fixture(scope="module")
def classifier() -> ConstellationClassifier:
    """A classifier of two classes that was not trained."""
    return random_classifier(("bench", "counter"))


def test_tokens_are_a_set():
    network, (profile, tokens) = random_network(SMALL), random_views(6, SMALL)[5]
    shuffled = tokens[np.random.default_rng(1).permutation(len(tokens))]
    np.testing.assert_allclose(
        network.logits(profile, shuffled), network.logits(profile, tokens), atol=1e-5
    )
    for k in range(len(tokens)):
        others = np.delete(tokens, k, axis=0)
        assert (
            np.abs(network.logits(profile, others) - network.logits(profile, tokens)).max() > 1e-4
        )


def test_networks_count_by_their_mean():
    both = random_network(SMALL)
    one = replace(SMALL, n_networks=1)
    for profile, tokens in random_views(4, SMALL):
        alone = [
            SetTransformer(
                one, {n: w[[k]] for n, w in both.weights.items()}, both.means, both.scales
            )
            for k in range(2)
        ]
        mean = np.mean([network.logits(profile, tokens) for network in alone], axis=0)
        np.testing.assert_allclose(both.logits(profile, tokens), mean, atol=1e-5)


def test_a_frame_is_labelled_and_an_empty_one_too(classifier):
    frame = table_frame(table_m=0.75, eye_m=1.5)
    scene = classifier.label(frame)
    features = levelled_features(frame, with_tokens=True)
    np.testing.assert_array_equal(
        classifier.label_features(features).probabilities, scene.probabilities
    )
    assert scene.probabilities.sum() == pytest.approx(1.0)
    assert np.isfinite(classifier.label(empty_frame()).probabilities).all()
    with pytest.raises(ValueError, match="features must have tokens, got none"):
        classifier.label_features(replace(features, tokens=None))


def test_a_classifier_is_restored_and_what_does_not_fit_is_refused(classifier):
    manifest, arrays = classifier.manifest(), classifier.arrays()
    again = ConstellationClassifier.from_arrays(manifest, arrays)
    frame = table_frame(table_m=0.75, eye_m=1.5)
    np.testing.assert_array_equal(
        again.label(frame).probabilities, classifier.label(frame).probabilities
    )
    for name, array in arrays.items():
        with pytest.raises(ValueError, match=f"constellation/{name} must be"):
            ConstellationClassifier.from_arrays(
                manifest, arrays | {name: np.zeros((*array.shape, 2))}
            )
        with pytest.raises(KeyError):
            ConstellationClassifier.from_arrays(
                manifest, {k: v for k, v in arrays.items() if k != name}
            )
    for name, value in (("scales", 0.0), ("temperature", 0.0), ("temperature", np.nan)):
        broken = arrays | {name: np.full_like(arrays[name], value)}
        with pytest.raises(ValueError, match=name):
            ConstellationClassifier.from_arrays(manifest, broken)
    with pytest.raises(ValueError, match="classes must be 2 names"):
        ConstellationClassifier.from_arrays(manifest | {"classes": ["bench", "bench"]}, arrays)


def test_what_labels_constellations_is_kept_as_arrays(tmp_path):
    levelled = train(levelled=True)
    model = replace(levelled, constellation_classifier=random_classifier(("a", "b", "c")))
    assert model.content_hash != levelled.content_hash
    models.save(model, tmp_path / "test.bof")
    loaded = models.load(tmp_path / "test.bof")
    frame = table_frame(table_m=0.75)
    expected, found = (m.labeller("constellation").label(frame) for m in (model, loaded))
    np.testing.assert_array_equal(found.probabilities, expected.probabilities)
    assert loaded.labeller() is loaded.levelled_classifier
    answer = label_frame(frame, loaded, name="a.png", source="test", by="constellation")
    assert answer.probability == found.probability
    with pytest.raises(ModelError, match="found no classifier of constellations, expected one"):
        levelled.labeller("constellation")


@pytest.mark.parametrize(
    ("name", "value"),
    [("n_heads", 0), ("width", 33), ("n_blocks", 10**9), ("max_tokens", -1), ("width", "8")],
)
def test_networks_that_there_cannot_be_are_refused(classifier, name, value):
    manifest = classifier.manifest()
    network = manifest["network"] | {name: value}
    with pytest.raises(ValueError, match=name):
        ConstellationClassifier.from_arrays(manifest | {"network": network}, classifier.arrays())


def test_without_pytorch_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(PluginError, match=r"found no torch .*; pip install 'slam-bof\[train\]'"):
        import_torch()


@pytest.mark.usefixtures("torch")
def test_numpy_and_pytorch_compute_the_same():
    views = random_views(20, SMALL)
    y = [int(len(tokens) > 3) for _, tokens in views]
    network = fit_transformer(views, y, SMALL, TransformerTraining(n_steps=30))
    slowly = np.array([network.logits(*view) for view in views])
    np.testing.assert_allclose(transformer_logits(network, views), slowly, atol=1e-5)
    again = fit_transformer(views, y, SMALL, TransformerTraining(n_steps=30))
    for name, weights in network.weights.items():
        assert weights.tobytes() == again.weights[name].tobytes()


@pytest.mark.usefixtures("torch")
def test_what_only_tokens_tell_is_learnt():
    """The class is whether a contour is at 0.4 m or 0.9 m; profiles are noise."""
    rng = np.random.default_rng(0)
    views, y = random_views(240, SMALL), rng.integers(0, 2, 240)
    for (_, tokens), label in zip(views, y, strict=True):
        if len(tokens):
            tokens[0, 0] = (-6.0, 6.0)[label]
    told = np.array([len(tokens) > 0 for _, tokens in views])
    network = fit_transformer(views[:160], y[:160], SMALL, TransformerTraining(n_steps=200))
    guessed = transformer_logits(network, views).argmax(axis=1)
    assert (guessed == y)[160:][told[160:]].mean() > 0.8


@pytest.mark.usefixtures("torch")
def test_a_classifier_learns_rooms(classifier):
    rng = np.random.default_rng(0)
    heights_m = [(0.45, 0.9)[k % 2] + rng.uniform(-0.04, 0.04) for k in range(24)]
    features = [
        levelled_features(table_frame(table_m=height, eye_m=1.5), with_tokens=True)
        for height in heights_m
    ]
    labels = ["bench", "counter"] * 12
    fitted = ConstellationClassifier.fit(
        features[:16], labels[:16], list(range(16)), training=TransformerTraining(n_steps=120)
    )
    assert [fitted.label_features(item).label for item in features[16:]] == labels[16:]
    again = ConstellationClassifier.from_arrays(fitted.manifest(), fitted.arrays())
    assert again.label_features(features[0]).probability == pytest.approx(
        fitted.label_features(features[0]).probability
    )
