"""Classifiers by name, and the search for the parameters of a support vector machine.

The names are those of ``slam-bof train --classifier``. All see square-rooted bags of words and get
calibrated probabilities around them (``scenes``).
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

__all__ = ["MACHINES", "Found", "MachineName", "make_machine", "search_svm"]

MachineName = Literal["svm-linear", "svm-rbf", "random-forest", "naive-bayes", "knn", "mlp"]
MACHINES: tuple[MachineName, ...] = get_args(MachineName)

COSTS = (0.01, 0.1, 1.0, 10.0, 100.0)
GAMMAS = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Of square-rooted bags, whose length is 1 at most."""
HIDDEN = 64
NEIGHBOURS = 5
TREES = 100


@dataclass(frozen=True, slots=True)
class Found:
    """What a grid search found best, and its accuracy in cross-validation.

    ``gamma`` is of the Gaussian kernel; "scale" for the linear machine, which has none.
    """

    name: MachineName
    C: float
    gamma: float | Literal["scale"]
    accuracy: float


def make_machine(
    name: MachineName, *, C: float = 1.0, gamma: float | Literal["scale"] = "scale", seed: int = 0
) -> Any:
    """Make a classifier, not fitted yet.

    Parameters
    ----------
    name
        One of ``MACHINES``.
    C, gamma
        Cost of a training error, and the kernel's width, of support vector machines.
    seed
        Of what is random.

    Raises
    ------
    ValueError
        If there is none of that name.
    """
    match name:
        case "svm-linear":
            return LinearSVC(C=C, random_state=seed, max_iter=10_000)
        case "svm-rbf":
            return SVC(C=C, gamma=gamma, kernel="rbf", random_state=seed)
        case "random-forest":
            return RandomForestClassifier(TREES, min_samples_leaf=2, random_state=seed)
        case "naive-bayes":
            return MultinomialNB(alpha=0.1)
        case "knn":
            return KNeighborsClassifier(NEIGHBOURS, weights="distance", algorithm="brute")
        case "mlp":
            return MLPClassifier(
                (HIDDEN,),
                alpha=1e-2,
                learning_rate_init=1e-2,
                tol=1e-3,
                max_iter=1000,
                random_state=seed,
            )
        case _:
            raise ValueError(f"name must be one of {', '.join(MACHINES)}, got {name!r}")


def search_svm(
    X: Any, y: NDArray[Any], folds: Sequence[Any], *, seed: int = 0
) -> tuple[Found, list[Found]]:
    """Search linear and Gaussian support vector machines over a grid of costs and widths.

    Parameters
    ----------
    X, y
        Square-rooted bags (n_frames, n_words), and their labels.
    folds
        (train, test) indices, for cross-validation.
    seed
        Of the solvers.

    Returns
    -------
    best : Found
        Of the highest accuracy; of equal ones the simplest: linear, of low cost.
    tried : list of Found
        All.
    """
    tried: list[Found] = []
    grids: list[tuple[MachineName, dict[str, Any]]] = [
        ("svm-linear", {"C": COSTS}),
        ("svm-rbf", {"C": COSTS[1:], "gamma": GAMMAS}),
    ]
    for name, grid in grids:
        machine = make_machine(name, seed=seed)
        found = GridSearchCV(machine, grid, cv=folds, refit=False).fit(X, y).cv_results_
        for params, accuracy in zip(found["params"], found["mean_test_score"], strict=True):
            gamma = params.get("gamma", "scale")
            tried.append(Found(name, float(params["C"]), gamma, float(np.float64(accuracy))))
    return max(tried, key=lambda one: one.accuracy), tried
