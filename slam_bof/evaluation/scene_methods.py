"""Ways to label frames with scenes: the product's, and descriptors with a classifier each.

Each is shown the frames to train with one by one, is then fitted, and gives probabilities of the
classes. A descriptor plug-in that finds local features has them turned into bags of words, with
the same classifier as the paper's; one that has a row for each frame has these standardised for a
support vector machine with a Gaussian kernel. Probabilities are Platt's, fitted on folds that hold
different moments.
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
from slam_bof.evaluation.descriptor_runs import Described, learn_bags
from slam_bof.ports import Descriptor
from slam_bof.scenes import (
    MACHINES,
    MachineName,
    Model,
    SceneClassifier,
    TrainingFrame,
    grouped_folds,
    make_machine,
    model as models,
    train_model,
)
from slam_bof.types import Array, DepthFrame

__all__ = ["OURS", "DescriptorMethod", "ModelMethod", "SceneMethod", "make_methods"]

OURS = "ours"
"""What the product's own labels go by among the methods."""
COST = 10.0
"""Of a training error, on standardised rows."""
Gray = NDArray[np.uint8]


class SceneMethod(Protocol):
    """One way to label frames."""

    name: str
    needs_gray: bool
    label: Cost
    """What labelling a frame costs, from the image on."""
    train: Cost
    """What training costs, describing the frames included."""

    def probabilities(self, frame: DepthFrame, gray: Gray | None) -> Array:
        """Return the probability of each class (C,), sorted by name, of a frame."""

    def nbytes(self) -> int:
        """Return how large what was learnt is."""


@dataclass
class ModelMethod:
    """The labels of a model, as ``slam-bof train`` makes it or one that is there already."""

    params: PlaceParams = field(default_factory=PlaceParams)
    n_words: int = 1024
    seed: int = 0
    levelled: bool = True
    model: Model | None = None
    name: str = OURS
    needs_gray: bool = False
    label: Cost = field(default_factory=Cost)
    train: Cost = field(default_factory=Cost)

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
                )
        except ValueError as error:
            raise DatasetError(f"cannot be trained: {error}") from error
        # Whoever makes the frames, and describes them by other methods, is no part of it.
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
        machine: MachineName | None = None,
    ) -> None:
        self.name = "+".join(names) + (f":{machine}" if machine else "")
        self._machine: MachineName = machine or "svm-rbf"
        self.label, self.train = Cost(), Cost()
        self._n_words, self._seed = n_words, seed
        pairs = zip(names, options or [{}] * len(names), strict=True)
        self._descriptors: list[Descriptor] = [
            registry.build("descriptors", plugin, chosen) for plugin, chosen in pairs
        ]
        self.needs_gray = any(descriptor.needs_gray for descriptor in self._descriptors)
        kinds = {descriptor.comparison == "bag" for descriptor in self._descriptors}
        if len(kinds) > 1 or (kinds == {True} and len(names) > 1):
            raise ValueError(f"bags of words cannot be put beside others, got {self.name}")
        self._is_bag = kinds == {True}
        self._found = Described(self._descriptors[0])

    def see(self, frame: DepthFrame, gray: Gray | None) -> None:
        """Take a frame to train with."""
        with self.train.measure():
            values = self._describe(frame, gray)
        self._found.keep(values)

    def fit(self, labels: Sequence[str], groups: Sequence[str]) -> None:
        """Fit the classifier to the frames taken, by their labels and moments."""
        y = np.array(labels)
        with self.train.measure():
            if self._is_bag:
                n_words = min(self._n_words, max(len(self._found), 2))
                self._bags, counts = learn_bags(
                    self._found, self.name, n_words=n_words, seed=self._seed
                )
                X = self._bags[1].transform(counts)
                self._classifier = SceneClassifier(
                    machine=self._machine, C=COST, seed=self._seed
                ).fit(X, y, groups)
            else:
                rows = np.concatenate(self._found.values).astype(np.float64)
                machine = make_machine(self._machine, C=COST, seed=self._seed)
                folds = list(grouped_folds(y, np.array(groups), self._seed))
                self._classifier = CalibratedClassifierCV(
                    make_pipeline(StandardScaler(), machine), cv=folds, ensemble=False
                ).fit(rows, y)
        self._found = Described(self._descriptors[0])

    def probabilities(self, frame: DepthFrame, gray: Gray | None) -> Array:
        """Return the probability of each class (C,), sorted by name, of a frame."""
        with self.label.measure():
            values = self._describe(frame, gray)
            if self._is_bag:
                vocabulary, tf_idf = self._bags
                numbers = self._found.numbers(values)
                scene = self._classifier.predict_bag(tf_idf.bag(vocabulary.lookup(numbers)))
                return np.asarray(scene.probabilities)
            return np.asarray(self._classifier.predict_proba(values.astype(np.float64))[0])

    def nbytes(self) -> int:
        """Return the size of words, idf and classifier, as a model file holds them."""
        import skops.io

        size = len(skops.io.dumps(self._classifier))
        if self._is_bag:
            size += self._bags[0].words_.nbytes + self._bags[1].idf_.nbytes
        return size

    def _describe(self, frame: DepthFrame, gray: Gray | None) -> NDArray[Any]:
        found = [descriptor.describe(frame, gray) for descriptor in self._descriptors]
        return found[0] if len(found) == 1 else np.concatenate(found, axis=1)


def make_methods(
    names: Sequence[str], *, n_words: int = 1024, seed: int = 0
) -> list[ModelMethod | DescriptorMethod]:
    """Make methods by name: ``ours``, descriptor plug-ins, and ``A+B`` for rows side by side.

    ``A:mlp`` has another classifier than the Gaussian support vector machine.

    Raises
    ------
    PluginError
        If there is no such plug-in.
    DatasetError
        If what is to be put side by side cannot be.
    """
    methods: list[ModelMethod | DescriptorMethod] = []
    for name in names:
        if name == OURS:
            methods.append(ModelMethod(n_words=n_words, seed=seed))
            continue
        plugins, _, classifier = name.partition(":")
        machine = next((known for known in MACHINES if known == classifier), None)
        if classifier and machine is None:
            expected = ", ".join(MACHINES)
            raise DatasetError(
                f"method {name!r}: found no classifier {classifier!r}, expected one of {expected}"
            )
        try:
            methods.append(
                DescriptorMethod(plugins.split("+"), n_words=n_words, seed=seed, machine=machine)
            )
        except ValueError as error:
            raise DatasetError(f"method {name!r}: {error}") from error
    return methods
