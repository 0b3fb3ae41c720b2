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
from sklearn.utils import Tags
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, check_non_negative, validate_data

from slam_bof.scenes.classifiers import ClassifierName, check_class_counts, make_classifier
from slam_bof.scenes.folds import make_folds
from slam_bof.types import Array, Bag, Scene

__all__ = ["SceneClassifier"]

STORED_NAMES = {"classifier": "machine"}
"""Parameters that model files name differently."""


@dataclass(eq=False, repr=False)
class SceneClassifier(ClassifierMixin, BaseEstimator):
    """A classifier of square-rooted bags of words, with calibrated probabilities.

    The square root turns inner products into the Bhattacharyya coefficients of bags (Hellinger
    kernel). Probabilities are Platt's, fitted on held-out folds.

    Parameters
    ----------
    kernel
        Kernel of the support vector machine: ``linear``, or ``rbf`` as in the paper.
    C
        Cost of a training error.
    n_folds
        Number of folds for calibration; fewer where the smallest class has fewer samples (or
        groups).
    seed
        Seed of the folds and the solver.
    gamma
        Width of the ``rbf`` kernel, or "scale" for scikit-learn's default.
    classifier
        None for the support vector machine with ``kernel``, or one of ``CLASSIFIERS``.

    Attributes
    ----------
    classes_ : (n_classes,)
        The labels, sorted.
    classifier_ : CalibratedClassifierCV
        The fitted classifier.
    """

    # Model files name the class by this path, and their content hash depends on it.
    __module__ = "slam_bof.scenes"

    kernel: Literal["linear", "rbf"] = "linear"
    C: float = 1.0
    n_folds: int = 5
    seed: int = 0
    gamma: float | Literal["scale"] = "scale"
    classifier: ClassifierName | None = None

    def fit(self, X: Any, y: Any, groups: ArrayLike | None = None) -> Self:
        """Learn from bags and their labels.

        Parameters
        ----------
        X
            (n_frames, n_words) bags of words, dense or csr.
        y
            (n_frames,) labels.
        groups
            (n_frames,) group of each frame, such as its sequence; no calibration fold splits one.

        Raises
        ------
        ValueError
            If there are fewer than two classes, or a class has fewer than two samples.
        """
        X, y = validate_data(self, X, y, accept_sparse="csr", dtype=np.float64)
        check_classification_targets(y)
        self.classes_, counts = np.unique(y, return_counts=True)
        check_class_counts(self.classes_, counts)
        self.classifier_ = CalibratedClassifierCV(
            make_classifier(self._name(), C=self.C, gamma=self.gamma, seed=self.seed),
            cv=make_folds(y, groups, self.n_folds, self.seed),
            ensemble=False,
        )
        self.classifier_.fit(_hellinger(X), y)
        # The folds are no longer needed and would only enlarge the model file.
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
        """Return the scene of one bag; an empty bag is classified like any other."""
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

    def __getstate__(self) -> dict[str, Any]:
        # Model files call this parameter "machine", as the first version of them did.
        state: dict[str, Any] = super().__getstate__()
        return {STORED_NAMES.get(name, name): value for name, value in state.items()}

    def __setstate__(self, state: dict[str, Any]) -> None:
        names = {stored: name for name, stored in STORED_NAMES.items()}
        super().__setstate__({names.get(name, name): value for name, value in state.items()})

    def _name(self) -> ClassifierName:
        return self.classifier or ("svm-linear" if self.kernel == "linear" else "svm-rbf")

    def _linear_probabilities(self, bag: Bag) -> Array:
        """Return what ``classifier_.predict_proba`` returns, without its slow checks."""
        (calibrated,) = self.classifier_.calibrated_classifiers_
        svm = calibrated.estimator
        margins = svm.coef_[:, bag.words] @ np.sqrt(bag.weights) + svm.intercept_
        slopes = np.array([sigmoid.a_ for sigmoid in calibrated.calibrators])
        offsets = np.array([sigmoid.b_ for sigmoid in calibrated.calibrators])
        positive: Array = expit(-(slopes * margins + offsets))
        if len(self.classes_) == 2:
            return np.concatenate([1.0 - positive, positive])
        total = positive.sum()
        return positive / total if total > 0 else np.full_like(positive, 1 / len(positive))


def _hellinger(X: Any) -> Any:
    """Return the square roots of bags, dense or csr."""
    check_non_negative(X, "SceneClassifier (bags)")
    return X.sqrt() if sparse.issparse(X) else np.sqrt(X)
