"""Scene labels of a finished trajectory, by all keyframes before and after.

What a keyframe shows lies before the camera: whoever leaves a room sees the next one for some
metres already, and then enters it. Smoothed as evidence of where the camera stands, every label
would come too early, whatever the model of time. So each keyframe's evidence goes to those that
stand where it looks, on whichever visit; then the hidden Markov model of ``scene_filter`` runs
forward and backward.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from slam_bof.scenes.hmm_filter import (
    SceneFilterParams,
    chance_of_change,
    decide,
    log_evidence,
    predict,
)
from slam_bof.types import Array, Scene

__all__ = ["place_evidence", "smooth"]

N_NEAR = 8
"""A keyframe's evidence goes to so many others at most."""
SUREST = 300.0
"""No room is less likely at a place than by this power of e, whoever looks at it,"""
LEAST_CHANGE = 1e-9
"""and no change less likely than this: so that no two of them leave nothing possible."""


def smooth(
    scenes: Sequence[Scene],
    stamps_s: ArrayLike,
    positions_m: ArrayLike,
    params: SceneFilterParams,
    *,
    axes: ArrayLike | None = None,
    parts: ArrayLike | None = None,
    segments: ArrayLike | None = None,
    sessions: ArrayLike | None = None,
) -> list[Scene]:
    """Label keyframes by all before and all after them (forward-backward algorithm).

    Parameters
    ----------
    scenes
        What the classifier says of each of K keyframes, all of the same classes.
    stamps_s, positions_m
        (K,) and (K, 3): when and where they are.
    params
        Of the model.
    axes
        (K, 3) unit vectors: the direction each looks in, in the frame of the positions. By
        default it counts as evidence of where it stands.
    parts
        (K,) the part of the map each is in: positions of different parts mean nothing to each
        other; by default all are in one.
    segments
        (K,) where this changes, positions mean nothing to those before; by default never.
    sessions
        (K,) where this changes, time and way mean nothing to those before; by default never.
    """
    if not scenes:
        return []
    positions_m = np.asarray(positions_m, dtype=np.float64)
    logs = log_evidence(
        np.array([scene.probabilities for scene in scenes]), params.smoothing_evidence
    )
    if axes is not None:
        looks_m = positions_m + params.ahead_m * np.asarray(axes, dtype=np.float64)
        where = np.zeros(len(scenes)) if parts is None else np.asarray(parts)
        logs = place_evidence(logs, looks_m, positions_m, where, params.spread_m)
    ways_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    ways_m[~np.isfinite(ways_m)] = 0.0
    if segments is not None:
        ways_m[np.diff(np.asarray(segments)) != 0] = 0.0
    changes = chance_of_change(np.diff(np.asarray(stamps_s, dtype=np.float64)), ways_m, params)
    if sessions is not None:
        # After this chance of a change every room is as likely as any other.
        changes[np.diff(np.asarray(sessions)) != 0] = 1.0 - 1.0 / logs.shape[1]
    logs = np.maximum(logs - logs.max(axis=1, keepdims=True), -SUREST)
    beliefs = _forward_backward(np.exp(logs), np.maximum(changes, LEAST_CHANGE))
    pairs = zip(beliefs, scenes, strict=True)
    return [decide(belief, scene.classes, params.min_probability) for belief, scene in pairs]


def place_evidence(
    logs: Array,
    looks_m: Array,
    positions_m: Array,
    parts: NDArray[np.generic],
    spread_m: float,
) -> Array:
    """Move the evidence of each keyframe to those that stand where it looks.

    Parameters
    ----------
    logs
        (K, C) logarithms of the evidence.
    looks_m, positions_m
        (K, 3) what they look at, and where they stand; those not finite keep their evidence.
    parts
        (K,) the part of the map each is in: none gives to another part.
    spread_m
        Gaussian width of the shares; the ``N_NEAR`` nearest get them, and the nearest one always
        does.

    Returns
    -------
    Array
        (K, C), of the same sum: what nobody looks at has none.

    Examples
    --------
    >>> x_m = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    >>> logs = np.array([[1.0], [2], [4]])
    >>> place_evidence(logs, x_m + [1, 0, 0], x_m, np.zeros(3), 0.1)[:, 0].round(9)
    array([0., 1., 6.])
    """
    placed = np.zeros_like(logs)
    known = np.isfinite(positions_m).all(axis=1) & np.isfinite(looks_m).all(axis=1)
    placed[~known] = logs[~known]
    for part in np.unique(parts[known]):
        ids = np.flatnonzero(known & (parts == part))
        n_near = min(N_NEAR, len(ids))
        apart_m, near = cKDTree(positions_m[ids]).query(looks_m[ids], k=n_near)
        apart_m, near = apart_m.reshape(-1, n_near), near.reshape(-1, n_near)
        shares = np.exp((apart_m[:, :1] ** 2 - apart_m**2) / (2.0 * spread_m**2))
        shares /= shares.sum(axis=1, keepdims=True)
        np.add.at(placed, ids[near], shares[..., None] * logs[ids, None])
    return placed


def _forward_backward(evidence: Array, changes: Array) -> Array:
    """Return the beliefs (K, C) by evidence (K, C) and chances of a change (K - 1,)."""
    forward, backward = evidence.copy(), np.ones_like(evidence)
    forward[0] /= forward[0].sum()
    for k in range(1, len(evidence)):
        forward[k] *= predict(forward[k - 1], changes[k - 1])
        forward[k] /= forward[k].sum()
    for k in range(len(evidence) - 2, -1, -1):
        # The transitions are symmetric, so looking back is predicting as well.
        backward[k] = predict(backward[k + 1] * evidence[k + 1], changes[k])
        backward[k] /= backward[k].sum()
    beliefs = forward * backward
    return np.asarray(beliefs / beliefs.sum(axis=1, keepdims=True))
