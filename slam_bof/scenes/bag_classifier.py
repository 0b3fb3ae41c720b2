"""Bags of words to scene labels with calibrated probabilities (paper, section 3.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.special import expit
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.calibration import CalibratedClassifierCV
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.utils import Tags
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, check_non_negative, validate_data

from slam_bof.scenes.classifiers import MachineName, make_machine
from slam_bof.types import Array, Bag, Scene

__all__ = ["SceneClassifier"]


@dataclass(eq=False, repr=False)
class SceneClassifier(ClassifierMixin, BaseEstimator):
    """A support vector machine on square-rooted bags, with calibrated probabilities.

    The square root turns the machine's inner products into the Bhattacharyya coefficients of
    bags (Hellinger kernel). Probabilities are Platt's, fitted on held-out folds.

    Parameters
    ----------
    kernel
        ``linear``, or ``rbf`` as the paper has it; of the support vector machine.
    C
        Cost of a training error.
    gamma
        Width of the ``rbf`` kernel, or "scale" for scikit-learn's choice.
    machine
        None for the support vector machine, or another of ``machines.MACHINES``.
    n_folds
        For calibration; fewer where the smallest class has fewer samples (or groups).
    seed
        Of the folds and the solver.

    Attributes
    ----------
    classes_ : (n_classes,)
        The labels, sorted.
    classifier_ : CalibratedClassifierCV
        The fitted machine.
    """

    # Model files name the class by this path, and their content hash is of that name too.
    __module__ = "slam_bof.scenes"

    kernel: Literal["linear", "rbf"] = "linear"
    C: float = 1.0
    n_folds: int = 5
    seed: int = 0
    gamma: float | Literal["scale"] = "scale"
    machine: MachineName | None = None

    def fit(self, X: Any, y: Any, groups: ArrayLike | None = None) -> Self:
        """Learn from bags (n_frames, n_words), dense or csr, and their labels.

        ``groups`` (n_frames,) names the sequence of each frame: frames of one sequence, which
        look alike, then never stand on both sides of a calibration fold.

        Raises
        ------
        ValueError
            If there are fewer than two classes, or a class has fewer than two samples.
        """
        X, y = validate_data(self, X, y, accept_sparse="csr", dtype=np.float64)
        check_classification_targets(y)
        self.classes_, counts = np.unique(y, return_counts=True)
        if len(self.classes_) < 2 or counts.min() < 2:
            found = ", ".join(f"{c}: {n}" for c, n in zip(self.classes_, counts, strict=True))
            raise ValueError(
                f"y must hold at least 2 classes of at least 2 samples each, got "
                f"{len(self.classes_)} class{'es' * (len(self.classes_) > 1)} ({found})"
            )
        self.classifier_ = CalibratedClassifierCV(
            self._machine(), cv=self.folds(y, groups), ensemble=False
        )
        self.classifier_.fit(_hellinger(X), y)
        # The folds have served: they would only swell the model file.
        self.classifier_.cv = None
        return self

    def predict_proba(self, X: Any) -> Array:
        """Return the probability of each class, (n_frames, n_classes), of bags."""
        check_is_fitted(self, "classifier_")
        X = validate_data(self, X, accept_sparse="csr", dtype=np.float64, reset=False)
        return np.asarray(self.classifier_.predict_proba(_hellinger(X)))

    def predict(self, X: Any) -> NDArray[Any]:
        """Return the most probable label, (n_frames,), of bags."""
        probabilities = self.predict_proba(X)
        return np.asarray(self.classes_[probabilities.argmax(axis=1)])

    def predict_bag(self, bag: Bag) -> Scene:
        """Return the scene of one bag; of an empty one, what the machine says of nothing."""
        check_is_fitted(self, "classifier_")
        if self._name() == "svm-linear":
            probabilities = self._linear_probabilities(bag)
        else:
            row = np.zeros((1, self.n_features_in_))
            row[0, bag.words] = np.sqrt(bag.weights)
            probabilities = np.asarray(self.classifier_.predict_proba(row))[0]
        best = int(probabilities.argmax())
        return Scene(
            label=str(self.classes_[best]),
            probability=float(probabilities[best]),
            classes=tuple(str(label) for label in self.classes_),
            probabilities=probabilities,
        )

    def __sklearn_tags__(self) -> Tags:
        tags: Tags = super().__sklearn_tags__()
        tags.input_tags.sparse = True
        tags.input_tags.positive_only = True
        return tags

    def _name(self) -> MachineName:
        return self.machine or ("svm-linear" if self.kernel == "linear" else "svm-rbf")

    def _machine(self) -> Any:
        return make_machine(self._name(), C=self.C, gamma=self.gamma, seed=self.seed)

    def _linear_probabilities(self, bag: Bag) -> Array:
        """Return what ``classifier_.predict_proba`` does, without its slow checks."""
        (calibrated,) = self.classifier_.calibrated_classifiers_
        machine = calibrated.estimator
        margins = machine.coef_[:, bag.words] @ np.sqrt(bag.weights) + machine.intercept_
        slopes = np.array([sigmoid.a_ for sigmoid in calibrated.calibrators])
        offsets = np.array([sigmoid.b_ for sigmoid in calibrated.calibrators])
        positive: Array = expit(-(slopes * margins + offsets))
        if len(self.classes_) == 2:
            return np.concatenate([1.0 - positive, positive])
        total = positive.sum()
        return positive / total if total > 0 else np.full_like(positive, 1 / len(positive))

    def folds(self, y: NDArray[Any], groups: ArrayLike | None) -> list[Any]:
        """Return the (train, test) indices of the calibration folds."""
        samples = np.arange(len(y)) if groups is None else np.asarray(groups)
        smallest = min(len(np.unique(samples[y == label])) for label in np.unique(y))
        n_folds = min(self.n_folds, smallest)
        if n_folds >= 2 and groups is not None:
            by_group = StratifiedGroupKFold(n_folds, shuffle=True, random_state=self.seed)
            return list(by_group.split(y, y, samples))
        # A class that one sequence alone shows cannot be split by sequence.
        n_folds = min(self.n_folds, np.unique(y, return_counts=True)[1].min())
        by_sample = StratifiedKFold(n_folds, shuffle=True, random_state=self.seed)
        return list(by_sample.split(y, y))


def _hellinger(X: Any) -> Any:
    """Return the square roots of bags, dense or csr."""
    check_non_negative(X, "SceneClassifier (bags)")
    return X.sqrt() if sparse.issparse(X) else np.sqrt(X)
