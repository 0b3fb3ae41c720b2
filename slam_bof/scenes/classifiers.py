"""Classifiers by name, and the search for the parameters of a support vector machine.

The names are those of ``slam-bof train --classifier``. ``SceneClassifier`` feeds them square-rooted
bags of words and calibrates their probabilities.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import GridSearchCV
from sklearn.naive_bayes import MultinomialNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.svm import SVC, LinearSVC

__all__ = [
    "CLASSIFIERS",
    "ClassifierName",
    "SvmParams",
    "check_class_counts",
    "make_classifier",
    "search_svm",
]

ClassifierName = Literal["svm-linear", "svm-rbf", "random-forest", "naive-bayes", "knn", "mlp"]
CLASSIFIERS: tuple[ClassifierName, ...] = get_args(ClassifierName)

COSTS = (0.01, 0.1, 1.0, 10.0, 100.0)
GAMMAS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Kernel widths that the grid search tries; the length of a square-rooted bag is at most 1."""
N_HIDDEN = 64
N_NEIGHBOURS = 5
N_TREES = 100


@dataclass(frozen=True, slots=True)
class SvmParams:
    """Parameters that a grid search tried, and their accuracy in cross-validation.

    ``gamma`` is the width of the Gaussian kernel; "scale" for a linear kernel, which has none.
    """

    name: ClassifierName
    C: float
    gamma: float | Literal["scale"]
    accuracy: float

    def __str__(self) -> str:
        """Return them in words."""
        gamma = "" if self.gamma == "scale" else f", gamma {self.gamma:g}"
        return f"{self.name}, C {self.C:g}{gamma}; accuracy {self.accuracy:.3f} in cross-validation"


def make_classifier(
    name: ClassifierName,
    *,
    C: float = 1.0,
    gamma: float | Literal["scale"] = "scale",
    seed: int = 0,
) -> Any:
    """Make a classifier, not fitted yet.

    Parameters
    ----------
    name
        One of ``CLASSIFIERS``.
    C, gamma
        Cost of a training error, and width of the kernel, of support vector machines.
    seed
        Seed of the random numbers.

    Raises
    ------
    ValueError
        If no classifier has that name.
    """
    match name:
        case "svm-linear":
            return LinearSVC(C=C, random_state=seed, max_iter=10_000)
        case "svm-rbf":
            return SVC(C=C, gamma=gamma, kernel="rbf", random_state=seed)
        case "random-forest":
            return RandomForestClassifier(N_TREES, min_samples_leaf=2, random_state=seed)
        case "naive-bayes":
            return MultinomialNB(alpha=0.1)
        case "knn":
            return KNeighborsClassifier(N_NEIGHBOURS, weights="distance", algorithm="brute")
        case "mlp":
            return MLPClassifier(
                (N_HIDDEN,),
                alpha=1e-2,
                learning_rate_init=1e-2,
                tol=1e-3,
                max_iter=1000,
                random_state=seed,
            )
        case _:
            raise ValueError(f"name must be one of {', '.join(CLASSIFIERS)}, got {name!r}")


def check_class_counts(classes: NDArray[Any], counts: NDArray[np.integer]) -> None:
    """Raise ``ValueError`` unless there are two classes with at least two samples each."""
    if len(classes) < 2 or counts.min() < 2:
        found = ", ".join(f"{c}: {n}" for c, n in zip(classes, counts, strict=True))
        raise ValueError(
            f"y must hold at least 2 classes of at least 2 samples each, got "
            f"{len(classes)} class{'es' * (len(classes) > 1)} ({found})"
        )


def search_svm(
    X: Any, y: NDArray[Any], folds: Sequence[Any], *, seed: int = 0
) -> tuple[SvmParams, list[SvmParams]]:
    """Search linear and Gaussian support vector machines over a grid of costs and widths.

    Parameters
    ----------
    X, y
        Square-rooted bags (n_frames, n_words), and their labels (n_frames,).
    folds
        (train, test) indices, for cross-validation.
    seed
        Seed of the solvers.

    Returns
    -------
    best : SvmParams
        Those of the highest accuracy; in a tie the simplest, that is linear and of low cost.
    tried : list of SvmParams
        All that were tried.
    """
    tried: list[SvmParams] = []
    grids: list[tuple[ClassifierName, dict[str, Any]]] = [
        ("svm-linear", {"C": COSTS}),
        ("svm-rbf", {"C": COSTS[1:], "gamma": GAMMAS}),
    ]
    for name, grid in grids:
        svm = make_classifier(name, seed=seed)
        results = GridSearchCV(svm, grid, cv=folds, refit=False).fit(X, y).cv_results_
        for params, accuracy in zip(results["params"], results["mean_test_score"], strict=True):
            gamma = params.get("gamma", "scale")
            tried.append(SvmParams(name, float(params["C"]), gamma, float(np.float64(accuracy))))
    return max(tried, key=lambda params: params.accuracy), tried
