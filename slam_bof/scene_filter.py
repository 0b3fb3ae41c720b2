"""Scene labels along a trajectory: a hidden Markov model over what single keyframes say.

The hidden state is the room that the camera is in. It stays the same from one keyframe to the
next but for a chance that grows with the time and the way between them; where it changes, every
other room is as likely. What the classifier says of a keyframe is its evidence, to a power below
1, since neighbours see much the same and err alike.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from slam_bof.types import Array, Params, Scene

__all__ = ["UNKNOWN", "SceneFilter", "SceneFilterParams", "decide", "smooth"]

UNKNOWN = "unknown"
"""The label of a keyframe whose most probable scene is not probable enough."""
FLOOR = 1e-6
"""No classifier is surer than this that a scene is none."""


class SceneFilterParams(Params):
    """How long the camera stays in a room, and how much a single keyframe counts."""

    stay_s: float = Field(60.0, gt=0, description="mean time in a room")
    stay_m: float = Field(4.0, gt=0, description="mean way within a room")
    evidence: float = Field(
        0.2, gt=0, le=1, description="power of a keyframe's probabilities; 1: all independent"
    )
    min_probability: float = Field(
        0.4, ge=0, le=1, description="below it the smoothed label is unknown"
    )


class SceneFilter:
    """Labels keyframes one by one, as they come, by all that came before.

    Examples
    --------
    >>> seen = Scene("office", 0.9, ("kitchen", "office"), np.array([0.1, 0.9]))
    >>> glimpse = Scene("kitchen", 0.6, ("kitchen", "office"), np.array([0.6, 0.4]))
    >>> scenes = SceneFilter(SceneFilterParams())
    >>> here = [scenes.update(s, 0.5 * k, (0, 0, 0)) for k, s in enumerate([seen, seen, glimpse])]
    >>> [scene.label for scene in here]
    ['office', 'office', 'office']
    """

    def __init__(self, params: SceneFilterParams) -> None:
        self._params = params
        self._belief: Array | None = None
        self._stamp_s = 0.0
        self._position_m = np.zeros(3)
        self._segment = 0

    def update(
        self, scene: Scene, stamp_s: float, position_m: ArrayLike, *, segment: int = 0
    ) -> Scene:
        """Take what the classifier says of a keyframe; return what is likely by now.

        Parameters
        ----------
        scene
            The keyframe's own label, of the same classes every time.
        stamp_s, position_m
            When and where (3,) it is, in any one frame.
        segment
            Where this changes, positions mean nothing to those before.
        """
        position_m = np.asarray(position_m, dtype=np.float64)
        evidence = _evidence(scene.probabilities, self._params)
        if self._belief is None:
            belief = evidence
        else:
            near = segment == self._segment
            way_m = float(np.linalg.norm(position_m - self._position_m)) if near else 0.0
            change = _change(stamp_s - self._stamp_s, way_m, self._params)
            belief = evidence * _predict(self._belief, change)
        self._belief = belief / belief.sum()
        self._stamp_s, self._position_m, self._segment = stamp_s, position_m, segment
        return decide(self._belief, scene.classes, self._params.min_probability)


def smooth(
    scenes: Sequence[Scene],
    stamps_s: ArrayLike,
    positions_m: ArrayLike,
    params: SceneFilterParams,
    *,
    segments: ArrayLike | None = None,
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
    segments
        (K,) where this changes, positions mean nothing to those before; by default never.
    """
    if not scenes:
        return []
    stamps_s = np.asarray(stamps_s, dtype=np.float64)
    positions_m = np.asarray(positions_m, dtype=np.float64)
    evidence = np.array([_evidence(scene.probabilities, params) for scene in scenes])
    ways_m = np.linalg.norm(np.diff(positions_m, axis=0), axis=1)
    if segments is not None:
        ways_m[np.diff(np.asarray(segments)) != 0] = 0.0
    changes = _change(np.diff(stamps_s), ways_m, params)
    forward, backward = evidence.copy(), np.ones_like(evidence)
    forward[0] /= forward[0].sum()
    for k in range(1, len(scenes)):
        forward[k] *= _predict(forward[k - 1], changes[k - 1])
        forward[k] /= forward[k].sum()
    for k in range(len(scenes) - 2, -1, -1):
        # The transitions are symmetric, so looking back is predicting as well.
        backward[k] = _predict(backward[k + 1] * evidence[k + 1], changes[k])
        backward[k] /= backward[k].sum()
    beliefs = forward * backward
    beliefs /= beliefs.sum(axis=1, keepdims=True)
    pairs = zip(beliefs, scenes, strict=True)
    return [decide(belief, scene.classes, params.min_probability) for belief, scene in pairs]


def decide(probabilities: Array, classes: tuple[str, ...], min_probability: float) -> Scene:
    """Return the most probable scene; ``UNKNOWN`` where that is less probable than asked for."""
    best = int(probabilities.argmax())
    probability = float(probabilities[best])
    label = classes[best] if probability >= min_probability else UNKNOWN
    return Scene(label, probability, classes, probabilities)


def _evidence(probabilities: Array, params: SceneFilterParams) -> Array:
    return np.asarray(np.maximum(probabilities, FLOOR) ** params.evidence)


def _change(seconds: ArrayLike, metres: ArrayLike, params: SceneFilterParams) -> Array:
    """Return the chance that the room changes in so much time, over so long a way."""
    rooms = np.maximum(seconds, 0.0) / params.stay_s + np.asarray(metres) / params.stay_m
    return np.asarray(-np.expm1(-rooms))


def _predict(belief: Array, change: Array | float) -> Array:
    """Return a distribution (C,), or a likelihood, one step on: the same, or any other."""
    n_others = max(len(belief) - 1, 1)
    return np.asarray((1.0 - change) * belief + change * (belief.sum() - belief) / n_others)
