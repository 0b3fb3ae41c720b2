"""A small neural network on numbers that describe a view, with calibrated probabilities.

The paper names per-layer BOFs in a neural network as its future work; this is one of few weights
that trains in a minute and answers in a fraction of a millisecond.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize_scalar
from scipy.special import log_softmax, softmax
from sklearn.base import BaseEstimator, ClassifierMixin
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold
from sklearn.neural_network import MLPClassifier
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data
from threadpoolctl import threadpool_limits

from slam_bof.types import Array

__all__ = ["SceneNetwork"]

FURTHEST = 4.0
"""Standard deviations from the mean, beyond which a number is taken to be there."""
LEARNING_RATE = 5e-4
BATCH = 200
MAX_PASSES = 300
TEMPERATURES = (0.3, 10.0)
UNGROUPED_TEMPERATURES = (1.0, 10.0)
"""Where frames of one sequence stand on both sides of a fold, held-out ones look more like those
trained on than what is to come does: they never make it more certain."""


@dataclass(eq=False, repr=False)
class SceneNetwork(ClassifierMixin, BaseEstimator):
    """Networks of one hidden layer that agree on a mean of logits, divided by a temperature.

    The temperature is the one under which samples held out from training are most probable.

    Parameters
    ----------
    n_hidden, n_networks
        Neurons of each network, and how many differently begun networks are averaged.
    decay
        Weight decay for each sample of a batch.
    n_steps
        Batches learnt from, at least, but samples are seen ``MAX_PASSES`` times at most.
    n_folds
        For the temperature; fewer where the smallest class has fewer samples (or groups).
    seed
        Of the networks and the folds.

    Attributes
    ----------
    classes_ : (n_classes,)
        The labels, sorted.
    mean_, scale_ : (D,) float32
        Of the numbers.
    hidden_, hidden_bias_, out_, out_bias_ : float32
        (D, n_networks n_hidden), its bias, and (n_networks n_hidden, n_classes), its bias.
    temperature_ : float
        What logits are divided by.
    """

    n_hidden: int = 128
    n_networks: int = 2
    decay: float = 0.01
    n_steps: int = 1200
    n_folds: int = 3
    seed: int = 0

    def fit(
        self,
        X: Any,
        y: Any,
        groups: ArrayLike | None = None,
        *,
        n_moments: int | None = None,
    ) -> Self:
        """Learn from numbers (n_frames, D) and their labels.

        ``groups`` (n_frames,) names the sequence of each frame: frames of one sequence, which
        look alike, then never stand on both sides of a fold. Where they are stretches of few
        sequences, ``n_moments`` is how many there are in all: what is held out is then no room
        never seen, and so many samples, not frames, say how sure one may be.

        Raises
        ------
        ValueError
            If there are fewer than two classes, or a class has fewer than two samples.
        """
        X, y = validate_data(self, X, y, dtype=np.float32)
        check_classification_targets(y)
        self.classes_, index, counts = np.unique(y, return_inverse=True, return_counts=True)
        if len(self.classes_) < 2 or counts.min() < 2:
            found = ", ".join(f"{c}: {n}" for c, n in zip(self.classes_, counts, strict=True))
            raise ValueError(
                f"y must hold at least 2 classes of at least 2 samples each, got "
                f"{len(self.classes_)} class{'es' * (len(self.classes_) > 1)} ({found})"
            )
        # With one thread sums have one order, and the same seed gives the same bytes.
        with threadpool_limits(1):
            held_out = np.zeros((len(X), len(self.classes_)), np.float32)
            for train, test in self._folds(index, groups):
                self._learn(X[train], index[train])
                held_out[test] = self._logits(X[test])
            self._learn(X, index)
        is_alike = groups is None or n_moments is not None
        bounds = UNGROUPED_TEMPERATURES if is_alike else TEMPERATURES
        self.temperature_ = _temperature(held_out, index, bounds, n_moments)
        return self

    def predict_proba(self, X: Any) -> Array:
        """Return the probability of each class, (n_frames, n_classes)."""
        check_is_fitted(self, "temperature_")
        X = validate_data(self, X, dtype=np.float32, reset=False)
        return self.probabilities(X)

    def predict(self, X: Any) -> NDArray[Any]:
        """Return the most probable label, (n_frames,)."""
        best = self.predict_proba(X).argmax(axis=1)
        return np.asarray(self.classes_[best])

    def probabilities(self, X: NDArray[np.float32]) -> Array:
        """Return what ``predict_proba`` does, without its slow checks."""
        logits = self._logits(X).astype(np.float64)
        return np.asarray(softmax(logits / self.temperature_, axis=-1))

    def _learn(self, X: NDArray[np.float32], index: NDArray[np.intp]) -> None:
        """Set the arrays by samples (n, D) and their classes (n,)."""
        self.mean_ = X.mean(axis=0)
        deviation = X.std(axis=0)
        self.scale_ = np.where(deviation > 1e-6, deviation, 1.0).astype(np.float32)
        inputs, batch = self._standardise(X), min(BATCH, len(X))
        n_passes = min(-(-self.n_steps * batch // len(X)), MAX_PASSES)
        networks = [
            MLPClassifier(
                (self.n_hidden,),
                alpha=self.decay * batch,
                batch_size=batch,
                learning_rate_init=LEARNING_RATE,
                max_iter=n_passes,
                n_iter_no_change=n_passes,
                random_state=self.seed + k,
            )
            for k in range(self.n_networks)
        ]
        with warnings.catch_warnings():
            # It stops where it is told to.
            warnings.simplefilter("ignore", ConvergenceWarning)
            for network in networks:
                network.fit(inputs, index)
        n_classes = len(self.classes_)
        outs = [_both_classes(n.coefs_[1], n_classes) / len(networks) for n in networks]
        biases = [_both_classes(n.intercepts_[1], n_classes) for n in networks]
        self.hidden_ = np.hstack([n.coefs_[0] for n in networks]).astype(np.float32)
        self.hidden_bias_ = np.hstack([n.intercepts_[0] for n in networks]).astype(np.float32)
        self.out_ = np.vstack(outs).astype(np.float32)
        self.out_bias_ = np.mean(biases, axis=0).astype(np.float32)

    def _standardise(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        return np.asarray(np.clip((X - self.mean_) / self.scale_, -FURTHEST, FURTHEST))

    def _logits(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        hidden = np.maximum(self._standardise(X) @ self.hidden_ + self.hidden_bias_, 0.0)
        return np.asarray(hidden @ self.out_ + self.out_bias_)

    def _folds(self, index: NDArray[np.intp], groups: ArrayLike | None) -> list[Any]:
        """Return the (train, test) indices of the folds, each with all classes in training."""
        samples = np.arange(len(index)) if groups is None else np.asarray(groups)
        n_classes = len(self.classes_)
        smallest = min(len(np.unique(samples[index == k])) for k in range(n_classes))
        n_folds = min(self.n_folds, smallest)
        if n_folds >= 2 and groups is not None:
            by_group = StratifiedGroupKFold(n_folds, shuffle=True, random_state=self.seed)
            folds = list(by_group.split(index, index, samples))
            if all(len(np.unique(index[train])) == n_classes for train, _ in folds):
                return folds
        # A class that one sequence alone shows cannot be split by sequence.
        n_folds = min(self.n_folds, int(np.bincount(index).min()))
        by_sample = StratifiedKFold(n_folds, shuffle=True, random_state=self.seed)
        return list(by_sample.split(index, index))


def _both_classes(weights: Array, n_classes: int) -> Array:
    """Return weights (..., n_classes) where two classes have one output, for the second."""
    if n_classes > 2:
        return weights
    return np.concatenate([np.zeros_like(weights), weights], axis=-1)


def _temperature(
    logits: NDArray[np.float32],
    index: NDArray[np.intp],
    bounds: tuple[float, float],
    n_moments: int | None = None,
) -> float:
    """Return what logits (n, n_classes) are best divided by, classes (n,) being true.

    With ``n_moments`` the truth counts for (n + 1) / (n + 2) only, as J. Platt has it with the
    number of samples ("Probabilistic outputs for support vector machines", 1999): that so many
    were right does not tell that the next one will be.
    """
    n_classes: int = logits.shape[1]

    def surprise(log_temperature: float) -> float:
        scaled = log_softmax(logits.astype(np.float64) / np.exp(log_temperature), axis=1)
        of_truth = float(-scaled[np.arange(len(index)), index].mean())
        if n_moments is None:
            return of_truth
        of_others = (float(-scaled.sum(axis=1).mean()) - of_truth) / (n_classes - 1)
        return ((n_moments + 1) * of_truth + of_others) / (n_moments + 2)

    logarithms = tuple(np.log(bounds))
    return float(np.exp(minimize_scalar(surprise, bounds=logarithms, method="bounded").x))
