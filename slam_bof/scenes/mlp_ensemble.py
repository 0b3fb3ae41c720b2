"""A small ensemble of neural networks on feature vectors, with calibrated probabilities.

The paper names per-layer BOFs in a neural network as its future work. These networks have few
weights, train in a minute and answer in a fraction of a millisecond.
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
from sklearn.neural_network import MLPClassifier
from sklearn.utils.multiclass import check_classification_targets
from sklearn.utils.validation import check_is_fitted, validate_data

from slam_bof.core import one_native_thread
from slam_bof.scenes.classifiers import check_class_counts
from slam_bof.scenes.folds import make_folds
from slam_bof.types import Array

__all__ = ["MlpEnsemble"]

MAX_DEVIATIONS = 4.0
"""Features are clipped at this many standard deviations from their mean."""
LEARNING_RATE = 5e-4
BATCH_SIZE = 200
MAX_EPOCHS = 300
TEMPERATURES = (0.3, 10.0)
"""Range of the temperature where folds hold out whole sequences."""
UNGROUPED_TEMPERATURES = (1.0, 10.0)
"""Range where frames of one sequence are on both sides of a fold. Held-out frames then resemble
the training frames more than new ones will, so they must not raise the confidence."""


@dataclass(eq=False, repr=False)
class MlpEnsemble(ClassifierMixin, BaseEstimator):
    """Networks of one hidden layer whose mean logits are divided by a temperature.

    The temperature minimises the negative log-likelihood of samples held out from training.

    Parameters
    ----------
    n_hidden, n_networks
        Neurons in the hidden layer of each network, and number of networks, which differ in their
        initial weights.
    decay
        Weight decay for each sample of a batch.
    n_steps
        Least number of batches to train on, but no more than ``MAX_EPOCHS`` passes over all
        samples.
    n_folds
        Number of folds for the temperature; fewer where the smallest class has fewer samples (or
        groups).
    seed
        Seed of the networks and the folds.
    n_components
        Train on this many principal components of the features, which is faster; None for all
        features. The weights that result are of the features themselves.

    Attributes
    ----------
    classes_ : (n_classes,)
        The labels, sorted.
    mean_, scale_ : (D,) float32
        Mean and standard deviation of each feature.
    hidden_, hidden_bias_, out_, out_bias_ : float32
        Weights of the hidden layers (D, n_networks n_hidden) and of the output layer
        (n_networks n_hidden, n_classes), with their biases.
    temperature_ : float
        Divisor of the logits.
    held_out_ : (n_frames, n_classes) float32
        Logits of the samples, each by networks trained without its fold; not saved with a model.
    """

    n_hidden: int = 128
    n_networks: int = 2
    decay: float = 0.01
    n_steps: int = 1200
    n_folds: int = 3
    seed: int = 0
    n_components: int | None = None

    def fit(
        self,
        X: Any,
        y: Any,
        groups: ArrayLike | None = None,
        *,
        n_groups: int | None = None,
        weights: ArrayLike | None = None,
        calibrate_on: NDArray[np.bool_] | None = None,
    ) -> Self:
        """Learn from feature vectors and their labels.

        Parameters
        ----------
        X
            (n_frames, D) features.
        y
            (n_frames,) labels.
        groups
            (n_frames,) group of each frame, such as its sequence; no fold splits one.
        n_groups
            Number of groups, where they are segments of sequences. Held-out frames then show
            rooms that are seen in training, and the confidence is limited as that number of
            samples, not the number of frames, permits.
        weights
            (n_frames,) weights of the samples in training; by default equal.
        calibrate_on
            (n_frames,) whether a sample counts for the temperature; by default all do.

        Raises
        ------
        ValueError
            If there are fewer than two classes, or a class has fewer than two samples.
        """
        X, y = validate_data(self, X, y, dtype=np.float32)
        check_classification_targets(y)
        self.classes_, index, counts = np.unique(y, return_inverse=True, return_counts=True)
        check_class_counts(self.classes_, counts)
        weight = None if weights is None else np.asarray(weights, np.float64)
        counted = np.ones(len(X), bool) if calibrate_on is None else calibrate_on
        # On one thread sums have one order, so the same seed gives the same bytes.
        with one_native_thread():
            held_out = np.zeros((len(X), len(self.classes_)), np.float32)
            for train, test in make_folds(index, groups, self.n_folds, self.seed):
                self._fit_networks(
                    X[train], index[train], None if weight is None else weight[train]
                )
                held_out[test] = self.logits(X[test])
            self._fit_networks(X, index, weight)
        self.held_out_ = held_out
        splits_sequences = groups is None or n_groups is not None
        bounds = UNGROUPED_TEMPERATURES if splits_sequences else TEMPERATURES
        self.temperature_ = _fit_temperature(held_out[counted], index[counted], bounds, n_groups)
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
        """Return what ``predict_proba`` returns, without its slow checks."""
        logits = self.logits(X).astype(np.float64)
        return np.asarray(softmax(logits / self.temperature_, axis=-1))

    def _fit_networks(
        self, X: NDArray[np.float32], index: NDArray[np.intp], weight: Array | None = None
    ) -> None:
        """Fit scale and weights to samples (n, D), their class indices (n,) and weights (n,)."""
        self.mean_ = X.mean(axis=0)
        deviation = X.std(axis=0)
        self.scale_ = np.where(deviation > 1e-6, deviation, 1.0).astype(np.float32)
        inputs, batch_size = self._standardise(X), min(BATCH_SIZE, len(X))
        components = None
        if self.n_components is not None:
            components = _principal_components(inputs, self.n_components)
            inputs = inputs @ components
        n_epochs = min(-(-self.n_steps * batch_size // len(X)), MAX_EPOCHS)
        networks = [
            MLPClassifier(
                (self.n_hidden,),
                alpha=self.decay * batch_size,
                batch_size=batch_size,
                learning_rate_init=LEARNING_RATE,
                max_iter=n_epochs,
                n_iter_no_change=n_epochs,
                random_state=self.seed + k,
            )
            for k in range(self.n_networks)
        ]
        with warnings.catch_warnings():
            # Stopping at max_iter is intended.
            warnings.simplefilter("ignore", ConvergenceWarning)
            for network in networks:
                network.fit(inputs, index, sample_weight=weight)
        n_classes = len(self.classes_)
        outs = [_output_per_class(n.coefs_[1], n_classes) / len(networks) for n in networks]
        biases = [_output_per_class(n.intercepts_[1], n_classes) for n in networks]
        hidden = np.hstack([n.coefs_[0] for n in networks]).astype(np.float32)
        self.hidden_ = hidden if components is None else components @ hidden
        self.hidden_bias_ = np.hstack([n.intercepts_[0] for n in networks]).astype(np.float32)
        self.out_ = np.vstack(outs).astype(np.float32)
        self.out_bias_ = np.mean(biases, axis=0).astype(np.float32)

    def _standardise(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        deviations = (X - self.mean_) / self.scale_
        return np.asarray(np.clip(deviations, -MAX_DEVIATIONS, MAX_DEVIATIONS))

    def hidden_values(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the values (N, n_networks n_hidden) of the hidden layers for features (N, D)."""
        hidden = self._standardise(X) @ self.hidden_ + self.hidden_bias_
        return np.asarray(np.maximum(hidden, 0.0))

    def logits(self, X: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mean logits (N, n_classes) of the networks for features (N, D)."""
        return np.asarray(self.hidden_values(X) @ self.out_ + self.out_bias_)


def _principal_components(inputs: NDArray[np.float32], n: int) -> NDArray[np.float32]:
    """Return the directions (D, min(n, D)) along which inputs (m, D) vary most."""
    centred = (inputs - inputs.mean(axis=0)).astype(np.float64)
    _, vectors = np.linalg.eigh(centred.T @ centred)
    largest = vectors[:, ::-1][:, :n]
    # The sign of an eigenvector is arbitrary.
    signs = np.sign(largest[np.abs(largest).argmax(axis=0), np.arange(largest.shape[1])])
    return np.asarray(largest * signs, np.float32)


def _output_per_class(weights: Array, n_classes: int) -> Array:
    """Return weights (..., n_classes); scikit-learn has one output where there are two classes."""
    if n_classes > 2:
        return weights
    return np.concatenate([np.zeros_like(weights), weights], axis=-1)


def _fit_temperature(
    logits: NDArray[np.float32],
    index: NDArray[np.intp],
    bounds: tuple[float, float],
    n_groups: int | None = None,
) -> float:
    """Return the temperature within ``bounds`` under which the true classes are most likely.

    ``logits`` (n, n_classes) are of held-out samples, ``index`` (n,) their true classes. With
    ``n_groups`` the target probability of the true class is (n + 1) / (n + 2) instead of 1, the
    correction of J. Platt for few samples ("Probabilistic outputs for support vector machines",
    1999), with the number of groups in place of that of samples.
    """
    n_classes: int = logits.shape[1]

    def cross_entropy(log_temperature: float) -> float:
        scaled = log_softmax(logits.astype(np.float64) / np.exp(log_temperature), axis=1)
        of_truth = float(-scaled[np.arange(len(index)), index].mean())
        if n_groups is None:
            return of_truth
        of_others = (float(-scaled.sum(axis=1).mean()) - of_truth) / (n_classes - 1)
        return ((n_groups + 1) * of_truth + of_others) / (n_groups + 2)

    log_bounds = tuple(np.log(bounds))
    return float(np.exp(minimize_scalar(cross_entropy, bounds=log_bounds, method="bounded").x))
