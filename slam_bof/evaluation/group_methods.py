"""Methods that label single images, to be compared on rooms that they were not trained with.

Each describes an image, is trained on descriptions with labels and groups, and returns classes with
their probabilities.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import PlaceParams, TfIdf, Vocabulary, count_words, descriptors
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost
from slam_bof.scenes import (
    N_WORDS,
    ConstellationClassifier,
    FurnitureNetwork,
    LevelledClassifier,
    LevelledFeatures,
    SceneClassifier,
    TransformerTraining,
    bof_tokens,
    import_torch,
    levelled_features,
    model as models,
    room_network,
    turned_tokens,
)
from slam_bof.types import Array, DepthFrame

__all__ = ["GROUP_METHODS", "GroupMethod", "make_group_method"]

Bag = NDArray[np.float32]

GROUP_METHODS = (
    "ours", "profile", "words", "profile+words", "tokens", "profile+tokens", "transformer",
    "profile+transformer", "bag:linear", "bag:rbf",
)  # fmt: skip
"""Methods by name. ``ours`` is the height profile and what furniture is seen, as ``train`` learns
them; ``profile`` is the height profile alone; ``words`` are those of shapes in level slices, which
models of earlier versions have beside it;
``tokens`` is a histogram of the kinds of placed BOFs, ``transformer`` attends to the set of them
(``--constellation`` of ``train`` is ``profile+transformer``); ``bag`` is the paper's bag of words
with a support vector machine."""


@dataclass
class GroupMethod:
    """A method with the description of every image, and of its copies by other sensors."""

    name: str
    describe: Callable[[DepthFrame, Array | None], Any]
    fit: Callable[[list[Any], list[list[Any]], list[str], list[str]], _Predictor]
    uses_copies: bool = True
    described: list[Any] = field(default_factory=list)
    copies: list[list[Any]] = field(default_factory=list)
    label_cost: Cost = field(default_factory=Cost)
    train_cost: Cost = field(default_factory=Cost)
    n_bytes: int = 0


_Predictor = tuple[Callable[[Any], tuple[tuple[str, ...], Array]], int]
"""What labels a described image with classes and their probabilities, and its size in bytes."""


def make_group_method(name: str, n_words: int, seed: int) -> GroupMethod:
    """Return the method of a name; ``DatasetError`` if there is none.

    ``n_words`` are those of the vocabulary of bags, and ``seed`` is that of classifiers.
    """
    match name:
        case "ours":
            network = models.included_furniture()
            describe = partial(_profile_and_furniture, furniture=network)
            return GroupMethod(name, describe, _fit_levelled(seed, furniture=network))
        case "profile":
            return GroupMethod(name, _profile_only, _fit_levelled(seed))
        case "words":
            return GroupMethod(name, _words_only, _fit_levelled(seed, N_WORDS))
        case "profile+words":
            return GroupMethod(name, _profile_and_words, _fit_levelled(seed, N_WORDS))
        case "tokens":
            return GroupMethod(name, _tokens_only, _fit_levelled(seed, N_WORDS))
        case "profile+tokens":
            return GroupMethod(name, _profile_and_tokens, _fit_levelled(seed, N_WORDS))
        case "transformer":
            import_torch()
            return GroupMethod(name, _set_only, _fit_constellation(seed))
        case "profile+transformer":
            import_torch()
            return GroupMethod(name, _set_and_profile, _fit_constellation(seed))
        case "bag:linear" | "bag:rbf":
            kernel = name.partition(":")[2]
            return GroupMethod(name, _bofs, _fit_bags(kernel, n_words, seed), uses_copies=False)
    raise DatasetError(f"method {name!r}: found none, expected some of {', '.join(GROUP_METHODS)}")


def _profile_only(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    return levelled_features(frame, gravity_camera=down)


def _profile_and_furniture(
    frame: DepthFrame, down: Array | None, furniture: FurnitureNetwork
) -> LevelledFeatures:
    return levelled_features(frame, gravity_camera=down, furniture=furniture)


def _profile_and_words(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    return levelled_features(frame, gravity_camera=down, with_shapes=True)


def _words_only(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    found = _profile_and_words(frame, down)
    return LevelledFeatures(np.zeros_like(found.profile), found.shapes)


def _tokens_only(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    tokens = turned_tokens(bof_tokens(frame, gravity_camera=down))
    return LevelledFeatures(np.zeros(1, np.float32), tokens)


def _profile_and_tokens(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    tokens = turned_tokens(bof_tokens(frame, gravity_camera=down))
    return LevelledFeatures(_profile_only(frame, down).profile, tokens)


def _set_only(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    tokens = bof_tokens(frame, gravity_camera=down)
    return LevelledFeatures(np.zeros(0, np.float32), tokens[:0], tokens=tokens)


def _set_and_profile(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    return levelled_features(frame, gravity_camera=down, with_tokens=True)


def _bofs(frame: DepthFrame, down: Array | None) -> NDArray[np.float32]:
    return descriptors(frame, PlaceParams())


def _predictor(classifier: LevelledClassifier | ConstellationClassifier) -> _Predictor:
    def predict(item: LevelledFeatures) -> tuple[tuple[str, ...], Array]:
        scene = classifier.label_features(item)
        return scene.classes, scene.probabilities

    return predict, sum(array.nbytes for array in classifier.arrays().values())


def _fit_levelled(
    seed: int, n_words: int = 0, furniture: FurnitureNetwork | None = None
) -> Callable[..., _Predictor]:
    def fit(
        features: list[LevelledFeatures],
        copies: list[list[LevelledFeatures]],
        labels: list[str],
        groups: list[str],
    ) -> _Predictor:
        classifier = LevelledClassifier.fit(
            features,
            labels,
            groups,
            copies=copies,
            n_words=n_words,
            weights=np.ones(len(labels)),
            network=room_network(seed),
            furniture=furniture,
            seed=seed,
        )
        return _predictor(classifier)

    return fit


def _fit_constellation(seed: int) -> Callable[..., _Predictor]:
    def fit(
        features: list[LevelledFeatures],
        copies: list[list[LevelledFeatures]],
        labels: list[str],
        groups: list[str],
    ) -> _Predictor:
        classifier = ConstellationClassifier.fit(
            features,
            labels,
            groups,
            copies=copies,
            training=TransformerTraining(seed=seed),
        )
        return _predictor(classifier)

    return fit


def _fit_bags(kernel: str, n_words: int, seed: int) -> Callable[..., _Predictor]:
    def fit(
        bofs: list[Bag], copies: list[list[Bag]], labels: list[str], groups: list[str]
    ) -> _Predictor:
        values = np.concatenate(bofs)
        vocabulary = Vocabulary(n_words=min(n_words, len(values)), seed=seed).fit(values)
        words = [vocabulary.lookup(item) for item in bofs]
        counts = count_words(words, vocabulary.n_words)
        tf_idf = TfIdf().fit(counts)
        svm = SceneClassifier(kernel="rbf" if kernel == "rbf" else "linear", C=10.0, seed=seed)
        svm.fit(tf_idf.transform(counts), np.array(labels), groups)

        def predict(item: Bag) -> tuple[tuple[str, ...], Array]:
            scene = svm.predict_bag(tf_idf.bag(vocabulary.lookup(item)))
            return scene.classes, scene.probabilities

        return predict, vocabulary.words_.nbytes + tf_idf.idf_.nbytes

    return fit
