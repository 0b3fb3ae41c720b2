"""Scene labels of a finished trajectory, each by all keyframes before and after it.

A keyframe shows what lies ahead of the camera: a camera that leaves a room sees the next one for
some metres before it enters it. As evidence of where the camera stands, every label would come too
early. Therefore each keyframe's evidence is moved to the keyframes that stand where it looks, on
any visit; then the hidden Markov model of ``hmm_filter`` runs forward and backward.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from slam_bof.scenes.hmm_filter import (
    SceneFilterParams,
    change_probability,
    most_probable_scene,
    predict,
    weighted_log_likelihood,
)
from slam_bof.scenes.view_novelty import novelties, path_sums, pooled
from slam_bof.types import Array, Scene

__all__ = ["place_evidence", "smooth"]

N_NEIGHBOURS = 8
"""A keyframe's evidence is shared among at most this many keyframes."""
MAX_LOG_RATIO = 300.0
"""Largest log-likelihood ratio between two scenes at a keyframe. With ``MIN_CHANGE`` it keeps the
product of contradicting keyframes from vanishing numerically."""
MIN_CHANGE = 1e-9
"""Least probability of a change from one keyframe to the next."""


def smooth(
    scenes: Sequence[Scene],
    stamps_s: ArrayLike,
    positions_m: ArrayLike,
    params: SceneFilterParams,
    *,
    axes: ArrayLike | None = None,
    components: ArrayLike | None = None,
    segments: ArrayLike | None = None,
    sessions: ArrayLike | None = None,
) -> list[Scene]:
    """Label keyframes by all keyframes before and after them (forward-backward algorithm).

    Parameters
    ----------
    scenes
        The classifier's label of each of K keyframes, all of the same classes.
    stamps_s, positions_m
        (K,) times and (K, 3) positions of the keyframes.
    params
        Parameters of the hidden Markov model.
    axes
        (K, 3) unit vectors of the viewing directions, in the frame of the positions. Without them
        a keyframe is evidence of where the camera stands. With them, a label is only as certain
        as new views make it (``view_novelty``).
    components
        (K,) component of the pose graph of each keyframe. Positions of different components are
        not comparable. By default all keyframes are in one component.
    segments
        (K,) odometry segment of each keyframe. The distance between consecutive keyframes of
        different segments is unknown. By default all are in one segment.
    sessions
        (K,) session of each keyframe. Neither time nor distance between consecutive keyframes of
        different sessions counts. By default all are of one session.
    """
    if not scenes:
        return []
    positions_m = np.asarray(positions_m, dtype=np.float64)
    logs = weighted_log_likelihood(
        np.array([scene.probabilities for scene in scenes]), params.smoothing_evidence_exponent
    )
    where = np.zeros(len(scenes)) if components is None else np.asarray(components)
    if axes is not None:
        seen_m = positions_m + params.look_ahead_m * np.asarray(axes, dtype=np.float64)
        logs = place_evidence(logs, seen_m, positions_m, where, params.spread_m)
    distances_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    distances_m[~np.isfinite(distances_m)] = 0.0
    if segments is not None:
        distances_m[np.diff(np.asarray(segments)) != 0] = 0.0
    durations_s = np.diff(np.asarray(stamps_s, dtype=np.float64))
    changes = change_probability(durations_s, distances_m, params)
    if sessions is not None:
        # With this probability of a change all scenes are equally likely afterwards.
        changes[np.diff(np.asarray(sessions)) != 0] = 1.0 - 1.0 / logs.shape[1]
        distances_m[np.diff(np.asarray(sessions)) != 0] = np.inf
    logs = np.maximum(logs - logs.max(axis=1, keepdims=True), -MAX_LOG_RATIO)
    beliefs = _forward_backward(np.exp(logs), np.maximum(changes, MIN_CHANGE))
    if axes is not None:
        new = novelties(positions_m, np.asarray(axes, dtype=np.float64), where)
        raw = weighted_log_likelihood(np.array([scene.probabilities for scene in scenes]), 1.0)
        views = np.column_stack([raw, new, np.ones_like(new)])
        views = place_evidence(views, seen_m, positions_m, where, params.spread_m)
        beliefs = _pool(beliefs.argmax(axis=1), views, distances_m, params.view_correlation)
    pairs = zip(beliefs, scenes, strict=True)
    return [
        most_probable_scene(belief, scene.classes, params.min_probability)
        for belief, scene in pairs
    ]


def _pool(best: NDArray[np.intp], views: Array, steps_m: Array, view_correlation: float) -> Array:
    """Return probabilities (K, C): each by the views along the path with the same best class.

    ``best`` (K,) is the most probable class. ``views`` (K, C + 2) are sums over the views of each
    place: logarithms of their probabilities, novelties, and their number. ``steps_m`` (K - 1,) is
    the length of the path from one to the next.
    """
    out = np.empty_like(views[:, :-2])
    for label in np.unique(best):
        own = best == label
        sums = path_sums(views * own[:, None], steps_m)[own]
        out[own] = pooled(sums[:, :-2], sums[:, -2], sums[:, -1], view_correlation)
    return out


def place_evidence(
    logs: Array,
    seen_m: Array,
    positions_m: Array,
    components: NDArray[np.generic],
    spread_m: float,
) -> Array:
    """Move the evidence of each keyframe to the keyframes that stand where it looks.

    Parameters
    ----------
    logs
        (K, C) log-likelihoods.
    seen_m, positions_m
        (K, 3) the point that each keyframe looks at, and where it stands. A keyframe keeps its
        evidence if either is not finite.
    components
        (K,) component of the pose graph of each keyframe; evidence stays within a component.
    spread_m
        Standard deviation of the Gaussian by which evidence is shared among the ``N_NEIGHBOURS``
        keyframes nearest to the point; the nearest always gets a share.

    Returns
    -------
    Array
        (K, C) log-likelihoods with the same column sums; zero for a keyframe that stands where no
        other looks.

    Examples
    --------
    >>> x_m = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    >>> logs = np.array([[1.0], [2], [4]])
    >>> place_evidence(logs, x_m + [1, 0, 0], x_m, np.zeros(3), 0.1)[:, 0].round(9)
    array([0., 1., 6.])
    """
    placed = np.zeros_like(logs)
    known = np.isfinite(positions_m).all(axis=1) & np.isfinite(seen_m).all(axis=1)
    placed[~known] = logs[~known]
    for component in np.unique(components[known]):
        ids = np.flatnonzero(known & (components == component))
        n = min(N_NEIGHBOURS, len(ids))
        distances_m, neighbours = cKDTree(positions_m[ids]).query(seen_m[ids], k=n)
        distances_m, neighbours = distances_m.reshape(-1, n), neighbours.reshape(-1, n)
        shares = np.exp((distances_m[:, :1] ** 2 - distances_m**2) / (2.0 * spread_m**2))
        shares /= shares.sum(axis=1, keepdims=True)
        np.add.at(placed, ids[neighbours], shares[..., None] * logs[ids, None])
    return placed


def _forward_backward(likelihoods: Array, changes: Array) -> Array:
    """Return the beliefs (K, C) given likelihoods (K, C) and change probabilities (K - 1,)."""
    forward, backward = likelihoods.copy(), np.ones_like(likelihoods)
    forward[0] /= forward[0].sum()
    for k in range(1, len(likelihoods)):
        forward[k] *= predict(forward[k - 1], changes[k - 1])
        forward[k] /= forward[k].sum()
    for k in range(len(likelihoods) - 2, -1, -1):
        # The transition matrix is symmetric, so the backward step is a prediction as well.
        backward[k] = predict(backward[k + 1] * likelihoods[k + 1], changes[k])
        backward[k] /= backward[k].sum()
    beliefs = forward * backward
    return np.asarray(beliefs / beliefs.sum(axis=1, keepdims=True))
