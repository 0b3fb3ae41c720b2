"""Test of a trained model on labelled frames, among them scenes that it does not know."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from slam_bof.datasets import LabelledFrame
from slam_bof.errors import DatasetError
from slam_bof.evaluation.scene_metrics import calibration_error, scene_scores
from slam_bof.scenes import UNKNOWN_LABEL, Model, SceneFilterParams
from slam_bof.types import Array

__all__ = ["MAX_DOUBTFUL", "evaluate_labeller", "label_figures"]

MAX_DOUBTFUL = 0.6
"""A wrong label of a higher probability is wrong and sure."""
Progress = Callable[[str, int, int], None]


def evaluate_labeller(
    model: Model,
    frames: Sequence[LabelledFrame],
    *,
    on_progress: Progress = lambda what, done, total: None,
) -> dict[str, Any]:
    """Label frames with a model; see ``label_figures`` for what is returned.

    Raises
    ------
    DatasetError
        If the model has no labels.
    """
    labeller = model.labeller()
    if labeller is None:
        raise DatasetError(f"the model ({model.trained_on}): found no labels, expected some")
    scenes = []
    for done, item in enumerate(frames, start=1):
        down = None if item.gravity_camera is None else np.array(item.gravity_camera)
        scenes.append(labeller.label(item.read(gray=False)[0], gravity_camera=down))
        on_progress("Labelling", done, len(frames))
    probabilities = np.array([scene.probabilities for scene in scenes])
    return label_figures(probabilities, scenes[0].classes, [frame.label for frame in frames])


def label_figures(
    probabilities: Array, classes: Sequence[str], true: Sequence[str]
) -> dict[str, Any]:
    """Score probabilities (N, C) against true scenes (N,), some of which may be no class.

    A label is ``unknown`` below the default of ``labels.min_probability``, which is right for a
    scene that is no class.

    Returns
    -------
    dict
        ``accuracy``, ``mean_class_accuracy`` and ``calibration_error`` of the most probable
        label, over frames of known scenes; over all frames ``answered``, the share that is
        labelled, ``right`` and ``wrong_and_sure`` (a wrong label above ``MAX_DOUBTFUL``);
        ``unknown_auroc``, the probability that a frame of a known scene has a more probable label
        than one of another scene; and ``by_class``. None where frames are missing.
    """
    best, confidence = probabilities.argmax(axis=1), probabilities.max(axis=1)
    min_probability = SceneFilterParams().min_probability
    predicted = np.array(classes)[best]
    labels = np.where(confidence >= min_probability, predicted, UNKNOWN_LABEL)
    truth = np.array(true)
    known = np.isin(truth, classes)
    right = labels == np.where(known, truth, UNKNOWN_LABEL)
    sure = (predicted != truth) & (confidence > MAX_DOUBTFUL)
    scores = None
    if known.any():
        scores = scene_scores(probabilities[known], truth[known].tolist(), classes)
    by_class = []
    for label in sorted(set(true)):
        rows = truth == label
        by_class.append(
            {
                "label": label,
                "n_frames": int(rows.sum()),
                "right": float(right[rows].mean()),
                "unknown": float((labels[rows] == UNKNOWN_LABEL).mean()),
                "wrong_and_sure": float(sure[rows].mean()),
            }
        )
    hits = (predicted == truth)[known]
    return {
        "accuracy": scores.accuracy if scores else None,
        "mean_class_accuracy": scores.mean_class_accuracy if scores else None,
        "calibration_error": calibration_error(confidence[known], hits) if scores else None,
        "answered": float((labels != UNKNOWN_LABEL).mean()),
        "right": float(right.mean()),
        "wrong_and_sure": float(sure.mean()),
        "unknown_auroc": _auroc(confidence[known], confidence[~known]),
        "by_class": by_class,
    }


def _auroc(positive: Array, negative: Array) -> float | None:
    """Return the probability that a positive value exceeds a negative one; ties count half."""
    if not len(positive) or not len(negative):
        return None
    difference = positive[:, None] - negative[None]
    return float((difference > 0).mean() + 0.5 * (difference == 0).mean())
