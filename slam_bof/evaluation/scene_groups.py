"""Scene labels of rooms never seen: labelled images, cross-validated by group (room).

Images of one room are alike, so a room is either trained with or tested with. Every method gets
the same folds; each image is described once.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold

from slam_bof.bof import PlaceParams, TfIdf, Vocabulary, count_words, descriptors
from slam_bof.datasets import LabelledFrame, sequence_names
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost, one_thread
from slam_bof.evaluation.scene_benchmark import SceneResult, each_by_itself
from slam_bof.evaluation.scene_metrics import scene_scores
from slam_bof.scenes import (
    N_WORDS,
    ConstellationClassifier,
    LevelledClassifier,
    LevelledFeatures,
    SceneClassifier,
    TransformerTraining,
    bof_tokens,
    import_torch,
    levelled_features,
    remeasure,
    room_network,
    turned_tokens,
)
from slam_bof.types import Array, DepthFrame

__all__ = ["GROUP_METHODS", "check_groups", "cross_validate_groups"]

Progress = Callable[[str, int, int], None]
Bag = NDArray[np.float32]

GROUP_METHODS = (
    "ours", "words", "profile+words", "tokens", "profile+tokens", "transformer",
    "profile+transformer", "bag:linear", "bag:rbf",
)  # fmt: skip
"""Methods by name. ``ours`` is the height profile, as ``train`` learns it; ``words`` are those of
shapes in level slices, which models of earlier versions have beside it;
``tokens`` is a histogram of the kinds of placed BOFs, ``transformer`` attends to the set of them
(``--constellation`` of ``train`` is ``profile+transformer``); ``bag`` is the paper's bag of words
with a support vector machine."""


@dataclass
class _Method:
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


def check_groups(frames: Sequence[LabelledFrame], n_folds: int) -> None:
    """Raise ``DatasetError`` unless there are two classes and a group for every fold."""
    classes, groups = {frame.label for frame in frames}, set(sequence_names(frames))
    if len(classes) < 2 or len(groups) < n_folds:
        raise DatasetError(
            f"found {len(classes)} classes in {len(groups)} groups, expected at least two classes "
            f"and as many groups as folds, {n_folds}"
        )


def cross_validate_groups(
    frames: Sequence[LabelledFrame],
    methods: Sequence[str] = GROUP_METHODS,
    *,
    n_folds: int = 5,
    n_repeats: int = 3,
    n_copies: int = 3,
    share: float = 1.0,
    n_words: int = 1024,
    seed: int = 0,
    n_jobs: int | None = 1,
    on_progress: Progress = lambda what, done, total: None,
) -> list[SceneResult]:
    """Test methods on groups that they were not trained with.

    Parameters
    ----------
    frames
        Labelled frames; those without a group are of the group of their sequence.
    methods
        Names among ``GROUP_METHODS``.
    n_folds, n_repeats
        Folds, and how many times the groups are dealt out to them.
    n_copies
        Copies of each training image as other sensors would have measured it.
    share
        Share of the training groups that is used, for a learning curve.
    n_words
        Words of the bags' vocabulary.
    seed
        Seed of folds, copies and classifiers.
    n_jobs
        Number of methods evaluated at a time; see ``compare_named_methods``.

    Returns
    -------
    list of SceneResult
        In the order of ``methods``; every frame is tested ``n_repeats`` times.

    Raises
    ------
    DatasetError
        If a method is unknown, or there are too few classes or groups.
    """
    check_groups(frames, n_folds)
    made = [_make(name, n_words, seed) for name in methods]
    if n_jobs != 1:
        alone = partial(
            cross_validate_groups,
            frames,
            n_folds=n_folds,
            n_repeats=n_repeats,
            n_copies=n_copies,
            share=share,
            n_words=n_words,
            seed=seed,
        )
        found = each_by_itself(alone, methods, n_jobs, on_progress)
        return [result for of_method in found for result in of_method]
    labels, groups = [frame.label for frame in frames], sequence_names(frames)
    classes = sorted(set(labels))
    y, g = np.array(labels), np.array(groups)
    with one_thread():
        _describe(frames, made, n_copies, seed, on_progress)
        probabilities: dict[str, list[Array]] = {method.name: [] for method in made}
        for repeat in range(n_repeats):
            out = {method.name: np.zeros((len(y), len(classes))) for method in made}
            folds = StratifiedGroupKFold(n_folds, shuffle=True, random_state=seed + repeat)
            for k, (train, test) in enumerate(folds.split(y, y, g)):
                train = _thin(train, y, g, share, seed + repeat)
                for method in made:
                    _test(method, train, test, y, g, classes, out[method.name])
                on_progress("Testing", repeat * n_folds + k + 1, n_repeats * n_folds)
            for name, values in out.items():
                probabilities[name].append(values)
    true = tuple(labels * n_repeats)
    results = []
    for method in made:
        p = np.concatenate(probabilities[method.name])
        results.append(
            SceneResult(
                method=method.name,
                scores=scene_scores(p, true, classes),
                probabilities=p,
                true=true,
                label_ms=method.label_cost.median_ms,
                train_s=method.train_cost.cpu_s / (n_folds * n_repeats),
                n_bytes=method.n_bytes,
            )
        )
    return results


def _thin(
    train: NDArray[np.intp], y: NDArray[Any], g: NDArray[Any], share: float, seed: int
) -> NDArray[np.intp]:
    """Return the training samples of a share of each class's groups, at least one group each."""
    if share >= 1.0:
        return train
    rng = np.random.default_rng(seed)
    kept: list[Any] = []
    for label in np.unique(y[train]):
        of_class = np.unique(g[train][y[train] == label])
        kept += rng.permutation(of_class)[: max(1, round(share * len(of_class)))].tolist()
    return train[np.isin(g[train], kept)]


def _describe(
    frames: Sequence[LabelledFrame],
    methods: Sequence[_Method],
    n_copies: int,
    seed: int,
    on_progress: Progress,
) -> None:
    rng = np.random.default_rng(seed)
    for done, item in enumerate(frames, start=1):
        frame, _ = item.read(gray=False)
        down = None if item.gravity_camera is None else np.array(item.gravity_camera)
        measured = [remeasure(frame, rng, down) for _ in range(n_copies)]
        for method in methods:
            # What a frame keeps of its first description would flatter the next method.
            fresh = replace(frame)
            with method.label_cost.measure():
                method.described.append(method.describe(fresh, down))
            copies = measured if method.uses_copies else []
            method.copies.append([method.describe(*copy) for copy in copies])
        on_progress("Describing", done, len(frames))


def _test(
    method: _Method,
    train: NDArray[np.intp],
    test: NDArray[np.intp],
    y: NDArray[Any],
    g: NDArray[Any],
    classes: Sequence[str],
    out: Array,
) -> None:
    """Train on some images; write the probabilities of others, in the order of ``classes``."""
    with method.train_cost.measure():
        predict, method.n_bytes = method.fit(
            [method.described[k] for k in train],
            [method.copies[k] for k in train],
            y[train].tolist(),
            g[train].tolist(),
        )
    for k in test:
        known, p = predict(method.described[k])
        out[k, [classes.index(name) for name in known]] = p


def _make(name: str, n_words: int, seed: int) -> _Method:
    """Return the method of a name."""
    match name:
        case "ours":
            return _Method(name, _profile_only, _fit_levelled(seed))
        case "words":
            return _Method(name, _words_only, _fit_levelled(seed, N_WORDS))
        case "profile+words":
            return _Method(name, _profile_and_words, _fit_levelled(seed, N_WORDS))
        case "tokens":
            return _Method(name, _tokens_only, _fit_levelled(seed, N_WORDS))
        case "profile+tokens":
            return _Method(name, _profile_and_tokens, _fit_levelled(seed, N_WORDS))
        case "transformer":
            import_torch()
            return _Method(name, _set_only, _fit_constellation(seed))
        case "profile+transformer":
            import_torch()
            return _Method(name, _set_and_profile, _fit_constellation(seed))
        case "bag:linear" | "bag:rbf":
            kernel = name.partition(":")[2]
            return _Method(name, _bofs, _fit_bags(kernel, n_words, seed), uses_copies=False)
    raise DatasetError(f"method {name!r}: found none, expected some of {', '.join(GROUP_METHODS)}")


def _profile_only(frame: DepthFrame, down: Array | None) -> LevelledFeatures:
    return levelled_features(frame, gravity_camera=down)


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


def _fit_levelled(seed: int, n_words: int = 0) -> Callable[..., _Predictor]:
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
