"""Scene labels as they come: a hidden Markov model over what single keyframes say.

The hidden state is the room that the camera is in. It stays the same from one keyframe to the
next but for a chance that grows with the time and the way between them; where it changes, every
other room is as likely. What the classifier says of a keyframe is its evidence, to a power below
1, since neighbours see much the same and err alike.

A keyframe tells of what it looks at, and who walks looks ahead. The filter counts that as evidence
of where the camera stands, a little early; that it is slow to believe makes up for it. At the end
``scene_smoothing`` puts the evidence where it belongs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from slam_bof.types import Array, Params, Scene

__all__ = [
    "UNKNOWN",
    "SceneFilter",
    "SceneFilterParams",
    "chance_of_change",
    "decide",
    "log_evidence",
    "predict",
]

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
    smoothing_evidence: float = Field(
        0.4, gt=0, le=1, description="the same when all are smoothed at the end"
    )
    ahead_m: float = Field(
        1.0, ge=0, description="smoothing: a keyframe tells of a place so far before the camera"
    )
    spread_m: float = Field(
        0.3, gt=0, description="smoothing: Gaussian width of its evidence around that place"
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
        evidence = np.exp(log_evidence(scene.probabilities, self._params.evidence))
        if self._belief is None:
            belief = evidence
        else:
            near = segment == self._segment
            way_m = float(np.linalg.norm(position_m - self._position_m)) if near else 0.0
            change = chance_of_change(stamp_s - self._stamp_s, way_m, self._params)
            belief = evidence * predict(self._belief, change)
        self._belief = belief / belief.sum()
        self._stamp_s, self._position_m, self._segment = stamp_s, position_m, segment
        return decide(self._belief, scene.classes, self._params.min_probability)


def decide(probabilities: Array, classes: tuple[str, ...], min_probability: float) -> Scene:
    """Return the most probable scene; ``UNKNOWN`` where that is less probable than asked for."""
    best = int(probabilities.argmax())
    probability = float(probabilities[best])
    label = classes[best] if probability >= min_probability else UNKNOWN
    return Scene(label, probability, classes, probabilities)


def log_evidence(probabilities: Array, power: float) -> Array:
    """Return the logarithm of what probabilities (..., C) of a classifier weigh."""
    return np.asarray(power * np.log(np.maximum(probabilities, FLOOR)))


def chance_of_change(seconds: ArrayLike, metres: ArrayLike, params: SceneFilterParams) -> Array:
    """Return the chance that the room changes in so much time, over so long a way."""
    rooms = np.maximum(seconds, 0.0) / params.stay_s + np.asarray(metres) / params.stay_m
    return np.asarray(-np.expm1(-rooms))


def predict(belief: Array, change: Array | float) -> Array:
    """Return a distribution (C,), or a likelihood, one step on: the same, or any other."""
    n_others = max(len(belief) - 1, 1)
    return np.asarray((1.0 - change) * belief + change * (belief.sum() - belief) / n_others)
