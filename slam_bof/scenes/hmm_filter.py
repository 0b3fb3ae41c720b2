"""Online scene labels: the forward filter of a hidden Markov model over single keyframes' labels.

The hidden state is the scene that the camera is in. From one keyframe to the next it changes with
a probability that grows with the time and the distance between them; all other scenes are then
equally likely. A keyframe's likelihood is the classifier's probability to a power below 1, since
neighbouring keyframes are similar and their errors are correlated. Where viewing directions are
known, the probabilities that result are tempered by how much of the views was new
(``view_novelty``), so that looking at the same wall again makes no label more certain.

A keyframe shows what lies ahead of the camera, so a walking camera sees the next room early. The
filter treats that as evidence of where the camera stands; its slow reaction compensates. When the
run is finished, ``hmm_smoother`` assigns the evidence to the places that were seen.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from slam_bof.core import GrowingArray
from slam_bof.scenes.view_novelty import PATH_M, novelty, pooled
from slam_bof.types import Array, Params, Scene

__all__ = [
    "UNKNOWN_LABEL",
    "LabelledBy",
    "SceneFilter",
    "SceneFilterParams",
    "change_probability",
    "most_probable_scene",
    "predict",
    "weighted_log_likelihood",
]

LabelledBy = Literal["levelled", "bag", "constellation"]
UNKNOWN_LABEL = "unknown"
"""The label of a keyframe whose most probable scene is not probable enough."""
MIN_PROBABILITY = 1e-6
"""A classifier's probabilities are clipped from below at this value."""


class SceneFilterParams(Params):
    """What labels keyframes, and the hidden Markov model of their labels."""

    by: LabelledBy = Field(
        "levelled",
        description="Classifier of keyframes: levelled for features of the levelled view (if the "
        "model has them, else bag), bag for the bag of words of the frame, as in the paper, and "
        "constellation for a set transformer on the frame's BOFs, if the model has one.",
    )
    mean_stay_s: float = Field(
        60.0, gt=0, description="Mean time that the camera stays in a room, in seconds."
    )
    mean_stay_m: float = Field(
        4.0, gt=0, description="Mean distance that the camera travels within a room, in metres."
    )
    evidence_exponent: float = Field(
        0.2,
        gt=0,
        le=1,
        description="Exponent of a keyframe's probabilities in the online filter. 1 treats "
        "keyframes as independent; less takes into account that neighbours are similar.",
    )
    smoothing_evidence_exponent: float = Field(
        0.4,
        gt=0,
        le=1,
        description="Exponent of a keyframe's probabilities when all keyframes are smoothed at "
        "the end of the run.",
    )
    view_correlation: float = Field(
        0.4,
        ge=0,
        le=1,
        description="Correlation between what different views of a place say of its scene. "
        "Smoothed labels are as certain as by n / (1 + (n - 1) * view_correlation) independent "
        "views, where n views show something new. Views of what was seen before add nothing.",
    )
    look_ahead_m: float = Field(
        1.0,
        ge=0,
        description="Smoothing assigns a keyframe's evidence to the place this far ahead of the "
        "camera, in metres.",
    )
    spread_m: float = Field(
        0.3,
        gt=0,
        description="Standard deviation of the Gaussian that spreads this evidence around that "
        "place, in metres.",
    )
    min_probability: float = Field(
        0.6,
        ge=0,
        le=1,
        description="Least probability of a label; a less probable one becomes 'unknown'.",
    )


class SceneFilter:
    """Labels keyframes online, each by itself and all keyframes before it.

    Examples
    --------
    >>> sure = Scene("office", 0.9, ("kitchen", "office"), np.array([0.1, 0.9]))
    >>> unsure = Scene("kitchen", 0.6, ("kitchen", "office"), np.array([0.6, 0.4]))
    >>> scenes = SceneFilter(SceneFilterParams())
    >>> labels = [scenes.update(s, 0.5 * k, (0, 0, 0)) for k, s in enumerate([sure, sure, unsure])]
    >>> [scene.label for scene in labels]
    ['office', 'office', 'office']
    """

    def __init__(self, params: SceneFilterParams) -> None:
        self._params = params
        self._belief: Array | None = None
        self._stamp_s = 0.0
        self._position_m = np.zeros(3)
        self._segment = 0
        self._seen = GrowingArray((2, 3), np.float64)  # positions and viewing directions
        self._sums: Array | None = None

    def update(
        self,
        scene: Scene,
        stamp_s: float,
        position_m: ArrayLike,
        *,
        axis: ArrayLike | None = None,
        segment: int = 0,
    ) -> Scene:
        """Update the belief with a keyframe, and return its filtered label.

        Parameters
        ----------
        scene
            The keyframe's own label, with the same classes every time.
        stamp_s, position_m
            Time and position (3,) of the keyframe, in one fixed frame.
        axis
            (3,) unit vector of the viewing direction in that frame. With it, the label is only as
            certain as new views make it.
        segment
            Number of the odometry segment. Positions of different segments are not comparable.
        """
        position_m = np.asarray(position_m, dtype=np.float64)
        exponent = self._params.evidence_exponent
        likelihood = np.exp(weighted_log_likelihood(scene.probabilities, exponent))
        if self._belief is None:
            belief = likelihood
        else:
            comparable = segment == self._segment
            distance_m = float(np.linalg.norm(position_m - self._position_m)) if comparable else 0.0
            change = change_probability(stamp_s - self._stamp_s, distance_m, self._params)
            belief = likelihood * predict(self._belief, change)
        self._belief = belief / belief.sum()
        probabilities = self._belief
        if axis is not None:
            axis = np.asarray(axis, dtype=np.float64)
            probabilities = self._pool(scene, int(self._belief.argmax()), position_m, axis, segment)
        self._stamp_s, self._position_m, self._segment = stamp_s, position_m, segment
        return most_probable_scene(probabilities, scene.classes, self._params.min_probability)

    def _pool(self, scene: Scene, best: int, position_m: Array, axis: Array, segment: int) -> Array:
        """Return the probabilities by the last views whose most probable scene was this one."""
        if segment != self._segment:
            self._seen.truncate(0)
        seen_m, axes = self._seen.rows[:, 0], self._seen.rows[:, 1]
        step_m = float(np.linalg.norm(position_m - seen_m[-1])) if len(seen_m) else 0.0
        decay = np.exp(-step_m / PATH_M) if np.isfinite(step_m) else 1.0
        new = novelty(position_m, axis, seen_m, axes)
        logs = weighted_log_likelihood(scene.probabilities, 1.0)
        before = np.zeros((len(logs), len(logs) + 2)) if self._sums is None else self._sums
        self._sums = before * decay
        self._sums[best] += [*logs, new, 1.0]
        self._seen.append([position_m, axis])
        own = self._sums[best]
        return pooled(own[:-2], own[-2], own[-1], self._params.view_correlation)


def most_probable_scene(
    probabilities: Array, classes: tuple[str, ...], min_probability: float
) -> Scene:
    """Return the most probable scene; ``UNKNOWN_LABEL`` if it is below ``min_probability``."""
    best = int(probabilities.argmax())
    probability = float(probabilities[best])
    label = classes[best] if probability >= min_probability else UNKNOWN_LABEL
    return Scene(label, probability, classes, probabilities)


def weighted_log_likelihood(probabilities: Array, exponent: float) -> Array:
    """Return the logarithm of probabilities (..., C) of a classifier to the power ``exponent``."""
    return np.asarray(exponent * np.log(np.maximum(probabilities, MIN_PROBABILITY)))


def change_probability(
    duration_s: ArrayLike, distance_m: ArrayLike, params: SceneFilterParams
) -> Array:
    """Return the probability that the scene changes within a time and a distance."""
    n_changes = (
        np.maximum(duration_s, 0.0) / params.mean_stay_s
        + np.asarray(distance_m) / params.mean_stay_m
    )
    return np.asarray(-np.expm1(-n_changes))


def predict(belief: Array, change: Array | float) -> Array:
    """Return a belief (C,) after one transition, given the probability of a change."""
    n_others = max(len(belief) - 1, 1)
    return np.asarray((1.0 - change) * belief + change * (belief.sum() - belief) / n_others)
