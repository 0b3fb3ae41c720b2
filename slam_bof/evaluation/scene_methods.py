"""Methods that label frames with scenes: slam_bof's own, and descriptors with a classifier each.

A method sees the training frames one by one, is then fitted, and returns probabilities of the
classes. Local features of a descriptor plug-in are turned into bags of words, for the paper's
classifier; a descriptor with one row a frame is standardised for a support vector machine with a
Gaussian kernel. Probabilities are Platt's, fitted on folds that split no sequence or segment.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.calibration import CalibratedClassifierCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from slam_bof.bof import PlaceParams
from slam_bof.core import registry
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost
from slam_bof.evaluation.descriptor_runs import DescriptorRun, learn_vocabulary
from slam_bof.ports import Descriptor
from slam_bof.scenes import (
    CLASSIFIERS,
    ClassifierName,
    Labeller,
    Model,
    SceneClassifier,
    SvmParams,
    TrainingFrame,
    make_classifier,
    make_folds,
    model as models,
    search_svm,
    train_model,
)
from slam_bof.types import Array, DepthFrame

__all__ = ["OURS", "DescriptorMethod", "ModelMethod", "SceneMethod", "make_methods"]

OURS = "ours"
"""Name of slam_bof's own model among the methods."""
GRID = "grid"
"""Suffix of a method whose support vector machine is found by grid search."""
COST = 10.0
"""Cost of a training error (C) of the support vector machines."""
N_FOLDS = 5
Gray = NDArray[np.uint8]


class SceneMethod(Protocol):
    """A method that labels frames."""

    name: str
    needs_gray: bool
    label: Cost
    """Cost of labelling, from the image to the probabilities."""
    train: Cost
    """Cost of training, including the description of the frames."""

    def probabilities(self, frame: DepthFrame, gray: Gray | None) -> Array:
        """Return the probability of each class (C,), sorted by name, of a frame."""

    def nbytes(self) -> int:
        """Return the size in bytes of what was learnt."""


@dataclass
class ModelMethod:
    """A model as ``slam-bof train`` makes it, or a given one."""

    params: PlaceParams = field(default_factory=PlaceParams)
    n_words: int = 1024
    seed: int = 0
    levelled: bool = True
    model: Model | None = None
    name: str = OURS
    needs_gray: bool = False
    label: Cost = field(default_factory=Cost)
    train: Cost = field(default_factory=Cost)
    _labeller: Labeller | None = field(init=False, repr=False, default=None)

    def __post_init__(self) -> None:
        """Label by the given model, if there is one."""
        if self.model is not None:
            self._labeller = self.model.labeller()

    def fit(self, frames: Iterable[TrainingFrame]) -> None:
        """Train on frames, read once, one by one."""
        reading = Cost()

        def read() -> Iterator[TrainingFrame]:
            rest = iter(frames)
            while True:
                with reading.measure():
                    frame = next(rest, None)
                if frame is None:
                    return
                yield frame

        try:
            with self.train.measure():
                self.model = train_model(
                    read(),
                    self.params,
                    n_words=self.n_words,
                    seed=self.seed,
                    trained_on="a comparison",
                    levelled=self.levelled,
                    furniture=models.included_furniture() if self.levelled else None,
                )
        except ValueError as error:
            raise DatasetError(f"cannot be trained: {error}") from error
        # Reading the frames, and describing them by other methods, is no part of this training.
        self.train.cpu_s -= reading.cpu_s
        self._labeller = self.model.labeller()

    def probabilities(self, frame: DepthFrame, gray: Gray | None) -> Array:
        """Return the probability of each class (C,), sorted by name, of a frame."""
        if self._labeller is None:
            raise RuntimeError("a method must be fitted first")
        with self.label.measure():
            scene = self._labeller.label(frame)
        order = np.argsort(scene.classes)
        return np.asarray(scene.probabilities[order])

    def nbytes(self) -> int:
        """Return the size of the model file."""
        if self.model is None:
            return 0
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "model.bof"
            models.save(self.model, file)
            return file.stat().st_size


class DescriptorMethod:
    """A descriptor plug-in, or several whose rows are put side by side, with a classifier."""

    def __init__(
        self,
        names: Sequence[str],
        *,
        options: Sequence[dict[str, Any]] = (),
        n_words: int = 1024,
        seed: int = 0,
        classifier: ClassifierName | None = None,
        grid_search: bool = False,
    ) -> None:
        suffix = GRID if grid_search else classifier
        self.name = "+".join(names) + (f":{suffix}" if suffix else "")
        self.svm_params: SvmParams | None = None
        """What the grid search chose."""
        self._classifier_name: ClassifierName = classifier or "svm-rbf"
        self._grid_search = grid_search
        self.label, self.train = Cost(), Cost()
        self._n_words, self._seed = n_words, seed
        pairs = zip(names, options or [{}] * len(names), strict=True)
        self._descriptors: list[Descriptor] = [
            registry.build("descriptors", plugin, chosen) for plugin, chosen in pairs
        ]
        self.needs_gray = any(descriptor.needs_gray for descriptor in self._descriptors)
        kinds = {descriptor.comparison in ("bag", "hamming") for descriptor in self._descriptors}
        if len(kinds) > 1 or (kinds == {True} and len(names) > 1):
            raise ValueError(f"bags of words cannot be put beside others, got {self.name}")
        self._is_bag = kinds == {True}
        if grid_search and not self._is_bag:
            raise ValueError(f"grid search is for bags of words, got {self.name}")
        self._run = DescriptorRun(self._descriptors[0])

    def add(self, frame: DepthFrame, gray: Gray | None) -> None:
        """Describe a training frame and keep its descriptors."""
        with self.train.measure():
            values = self._describe(frame, gray)
        self._run.keep(values)

    def fit(self, labels: Sequence[str], groups: Sequence[str]) -> None:
        """Fit the classifier to the frames added, given their labels and groups (n_frames,)."""
        y = np.array(labels)
        with self.train.measure():
            if self._is_bag:
                n_words = min(self._n_words, max(len(self._run), 2))
                self._vocabulary, counts = learn_vocabulary(
                    self._run, self.name, n_words=n_words, seed=self._seed
                )
                X = self._vocabulary[1].transform(counts)
                self._classifier = self._choose_classifier(X, y, groups).fit(X, y, groups)
            else:
                rows = np.concatenate(self._run.values).astype(np.float64)
                classifier = make_classifier(self._classifier_name, C=COST, seed=self._seed)
                folds = make_folds(y, groups, N_FOLDS, self._seed)
                self._classifier = CalibratedClassifierCV(
                    make_pipeline(StandardScaler(), classifier), cv=folds, ensemble=False
                ).fit(rows, y)
        self._run = DescriptorRun(self._descriptors[0])

    def _choose_classifier(self, X: Any, y: NDArray[Any], groups: Sequence[str]) -> SceneClassifier:
        """Return a classifier of bags, with parameters by grid search if that is asked for."""
        if not self._grid_search:
            return SceneClassifier(classifier=self._classifier_name, C=COST, seed=self._seed)
        folds = make_folds(y, groups, N_FOLDS, self._seed)
        self.svm_params, _ = search_svm(np.sqrt(X.toarray()), y, folds, seed=self._seed)
        found = self.svm_params
        return SceneClassifier(classifier=found.name, C=found.C, gamma=found.gamma, seed=self._seed)

    def probabilities(self, frame: DepthFrame, gray: Gray | None) -> Array:
        """Return the probability of each class (C,), sorted by name, of a frame."""
        with self.label.measure():
            values = self._describe(frame, gray)
            if self._is_bag:
                vocabulary, tf_idf = self._vocabulary
                words = vocabulary.lookup(self._run.as_float(values))
                scene = self._classifier.predict_bag(tf_idf.bag(words))
                return np.asarray(scene.probabilities)
            return np.asarray(self._classifier.predict_proba(values.astype(np.float64))[0])

    def nbytes(self) -> int:
        """Return the size of words, idf and classifier, as a model file holds them."""
        import skops.io

        size = len(skops.io.dumps(self._classifier))
        if self._is_bag:
            vocabulary, tf_idf = self._vocabulary
            size += vocabulary.words_.nbytes + tf_idf.idf_.nbytes
        return size

    def _describe(self, frame: DepthFrame, gray: Gray | None) -> NDArray[Any]:
        values = [descriptor.describe(frame, gray) for descriptor in self._descriptors]
        return values[0] if len(values) == 1 else np.concatenate(values, axis=1)


def make_methods(
    names: Sequence[str], *, n_words: int = 1024, seed: int = 0
) -> list[ModelMethod | DescriptorMethod]:
    """Make methods by name.

    A name is ``ours``, that of a descriptor plug-in, or ``A+B`` for the concatenated rows of
    several; ``A:mlp`` uses another of ``CLASSIFIERS`` than the Gaussian support vector machine.
    ``A:grid`` searches a support vector machine for bags by cross-validation of the training
    frames, as the paper does (section 4.1).

    Raises
    ------
    PluginError
        If there is no such plug-in.
    DatasetError
        If there is no such classifier, or the descriptors cannot be concatenated.
    """
    methods: list[ModelMethod | DescriptorMethod] = []
    for name in names:
        if name == OURS:
            methods.append(ModelMethod(n_words=n_words, seed=seed))
            continue
        plugins, _, suffix = name.partition(":")
        grid_search = suffix == GRID
        classifier = next((known for known in CLASSIFIERS if known == suffix), None)
        if suffix and classifier is None and not grid_search:
            expected = ", ".join((*CLASSIFIERS, GRID))
            raise DatasetError(
                f"method {name!r}: found no classifier {suffix!r}, expected one of {expected}"
            )
        try:
            method = DescriptorMethod(
                plugins.split("+"),
                n_words=n_words,
                seed=seed,
                classifier=classifier,
                grid_search=grid_search,
            )
            methods.append(method)
        except ValueError as error:
            raise DatasetError(f"method {name!r}: {error}") from error
    return methods
