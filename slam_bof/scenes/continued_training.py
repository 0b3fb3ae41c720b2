"""Continue the training of a network with new samples, when the old ones are no longer at hand.

The paper's robot goes on learning in the rooms where it works. Only the output layer changes. So
that it keeps what it knew, it also answers random inputs as before (A. Robins, "Catastrophic
forgetting, rehearsal and pseudorehearsal", 1995), and weights are pulled towards their old values.
A class that it did not know gets an output of its own. The temperature stays.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from scipy.special import log_softmax

from slam_bof.core import one_native_thread
from slam_bof.scenes.mlp_ensemble import MlpEnsemble
from slam_bof.types import Array

__all__ = ["continue_network"]

PULL = 1e-3
"""Weight of the squared change of a logit against the cross entropy of a sample."""
N_REHEARSED, REHEARSAL = 2000, 4.0
"""Number of random inputs, and their weight against the new samples, together."""


def continue_network(
    network: MlpEnsemble, X: NDArray[np.float32], y: NDArray[np.str_], weights: ArrayLike | None
) -> MlpEnsemble:
    """Return a network that learnt from further samples, of old classes and new ones.

    Parameters
    ----------
    network
        A fitted network, which stays as it is.
    X, y
        (N, D) features of the new samples, and their labels (N,).
    weights
        (N,) weights of the samples; by default equal.
    """
    classes = np.unique(np.concatenate([network.classes_, y]))
    old = np.searchsorted(classes, network.classes_)
    rng = np.random.default_rng(network.seed)
    shape = (N_REHEARSED, X.shape[1])
    rehearsed = network.mean_ + network.scale_ * rng.standard_normal(shape, np.float32)
    targets = np.zeros((len(X) + N_REHEARSED, len(classes)))
    targets[np.arange(len(X)), np.searchsorted(classes, y)] = 1.0
    targets[len(X) :, old] = network.probabilities(rehearsed)
    weight = np.ones(len(X)) if weights is None else np.asarray(weights, np.float64)
    weight = np.concatenate([weight / weight.sum(), np.full(N_REHEARSED, REHEARSAL / N_REHEARSED)])
    hidden = network.hidden_values(np.concatenate([X, rehearsed])).astype(np.float64)
    before = np.zeros_like(targets)
    before[:, old] = hidden @ network.out_ + network.out_bias_
    # The bias is the weight of a constant input, and as hard to move as those of all others.
    power = float(np.einsum("ij,ij->", hidden, hidden)) / len(hidden)
    inputs = np.column_stack([hidden, np.full(len(hidden), np.sqrt(power))])

    def loss(flat: Array) -> tuple[float, Array]:
        change = flat.reshape(inputs.shape[1], len(classes))
        logs = log_softmax((before + inputs @ change) / network.temperature_, axis=1)
        residuals = weight[:, None] * (np.exp(logs) - targets) / network.temperature_
        cross_entropy = -float(weight @ (targets * logs).sum(axis=1))
        pull = 0.5 * PULL * power * float(flat @ flat)
        gradient = inputs.T @ residuals + PULL * power * change
        return cross_entropy + pull, gradient.ravel()

    # On one thread sums have one order, so the same samples give the same bytes.
    with one_native_thread():
        start = np.zeros(inputs.shape[1] * len(classes))
        found = minimize(loss, start, jac=True, method="L-BFGS-B", options={"maxiter": 200})
    change = found.x.reshape(inputs.shape[1], len(classes))
    continued = copy(network)
    continued.classes_ = classes
    continued.out_ = np.zeros((hidden.shape[1], len(classes)), np.float32)
    continued.out_[:, old] = network.out_
    continued.out_ += change[:-1].astype(np.float32)
    continued.out_bias_ = np.zeros(len(classes), np.float32)
    continued.out_bias_[old] = network.out_bias_
    continued.out_bias_ += (change[-1] * np.sqrt(power)).astype(np.float32)
    return continued
