"""Metrics of scene labels and their probabilities."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import Array

__all__ = [
    "ClassScore",
    "Roc",
    "SceneScores",
    "calibration_error",
    "confusion",
    "reliability",
    "roc",
    "scene_accuracy",
    "scene_scores",
]

N_BINS = 15
"""Number of bins of confidence."""


@dataclass(frozen=True, slots=True)
class ClassScore:
    """Metrics of one class; None where no frame was labelled so, or none shows it."""

    label: str
    n_frames: int
    precision: float | None
    recall: float | None
    f1: float | None


@dataclass(frozen=True, slots=True, eq=False)
class SceneScores:
    """Metrics of labels with probabilities on N test frames.

    ``accuracy`` is the share of frames with the right label, ``mean_class_accuracy`` the mean
    recall of the classes, and ``calibration_error`` the expected calibration error (ECE).
    ``confusion`` (C, C) counts frames by true class (row) and predicted class (column), both in
    the order of ``classes``.
    """

    classes: tuple[str, ...]
    accuracy: float
    mean_class_accuracy: float
    calibration_error: float
    by_class: tuple[ClassScore, ...]
    confusion: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Roc:
    """ROC curve of one class against all others: rates (T,), and the area under the curve."""

    label: str
    false_positive: Array
    true_positive: Array
    auc: float


def scene_scores(probabilities: Array, true: Sequence[str], classes: Sequence[str]) -> SceneScores:
    """Score probabilities (N, C), in the order of ``classes``, against the true labels (N,).

    Raises
    ------
    ValueError
        If there are no frames.

    Examples
    --------
    >>> probabilities = np.array([[0.9, 0.1], [0.6, 0.4]])
    >>> scores = scene_scores(probabilities, ["kitchen", "office"], ["kitchen", "office"])
    >>> scores.accuracy, round(scores.calibration_error, 3), scores.confusion.tolist()
    (0.5, 0.35, [[1, 0], [1, 0]])
    """
    if len(true) == 0:
        raise ValueError("true must have at least one label, got none")
    names = tuple(classes)
    predicted = [names[k] for k in probabilities.argmax(axis=1)]
    counts = confusion(predicted, true, names)
    right = counts.diagonal()
    recalls, precisions = (_ratios(right, counts.sum(axis=axis)) for axis in (1, 0))
    by_class = []
    for name, n, p, r in zip(names, counts.sum(axis=1), precisions, recalls, strict=True):
        f1 = None if p is None or r is None else (2 * p * r / (p + r) if p + r else 0.0)
        by_class.append(ClassScore(name, int(n), p, r, f1))
    is_right = np.array(predicted) == np.array(true)
    return SceneScores(
        classes=names,
        accuracy=float(is_right.mean()),
        mean_class_accuracy=float(np.mean([r for r in recalls if r is not None])),
        calibration_error=calibration_error(probabilities.max(axis=1), is_right),
        by_class=tuple(by_class),
        confusion=counts,
    )


def calibration_error(confidence: Array, is_right: NDArray[np.bool_]) -> float:
    """Return the expected calibration error of N labels (Naeini et al., AAAI 2015), in 15 bins.

    It is the mean absolute difference between the accuracy and the mean confidence of a bin,
    weighted by the number of labels in the bin.

    >>> calibration_error(np.array([0.8, 0.8, 0.8, 0.8, 0.8]), np.array([1, 1, 1, 1, 0], bool))
    0.0
    """
    means, shares, counts = reliability(confidence, is_right)
    return float(np.sum(counts * np.abs(shares - means)) / max(counts.sum(), 1))


def reliability(
    confidence: Array, is_right: NDArray[np.bool_]
) -> tuple[Array, Array, NDArray[np.intp]]:
    """Return the mean confidence, accuracy and number of labels of each bin that is not empty."""
    bins = np.minimum((confidence * N_BINS).astype(np.intp), N_BINS - 1)
    counts = np.bincount(bins, minlength=N_BINS)
    used = counts > 0
    sums = (np.bincount(bins, weights, N_BINS)[used] for weights in (confidence, is_right))
    means, shares = (total / counts[used] for total in sums)
    return means, shares, counts[used]


def roc(probabilities: Array, true: Sequence[str], classes: Sequence[str]) -> list[Roc]:
    """Return the ROC curve of each class that some frames show and others do not."""
    from sklearn.metrics import auc, roc_curve

    curves = []
    for name, values in zip(classes, probabilities.T, strict=True):
        truth = np.array([label == name for label in true])
        if truth.any() and not truth.all():
            false_positive, true_positive, _ = roc_curve(truth, values)
            area = float(auc(false_positive, true_positive))
            curves.append(Roc(name, false_positive, true_positive, area))
    return curves


def _ratios(counts: NDArray[np.int64], totals: NDArray[Any]) -> list[float | None]:
    pairs = zip(counts.tolist(), totals.tolist(), strict=True)
    return [count / total if total else None for count, total in pairs]


def scene_accuracy(
    predicted: Sequence[str | None], true: Sequence[str | None] | None
) -> float | None:
    """Return the share of right labels among the frames whose true label is known.

    A frame without a predicted label (None) counts as wrong. The result is None where no frame has
    a predicted label, or none a true one.

    >>> scene_accuracy(["office", "kitchen", None, "office"], ["office", "office", "office", None])
    0.3333333333333333
    """
    if true is None or all(label is None for label in predicted):
        return None
    right = [p == t for p, t in zip(predicted, true, strict=True) if t is not None]
    return float(np.mean(right)) if right else None


def confusion(
    predicted: Sequence[str], true: Sequence[str], classes: Sequence[str]
) -> NDArray[np.int64]:
    """Count (C, C) frames by true class (row) and predicted class (column)."""
    counts = np.zeros((len(classes), len(classes)), dtype=np.int64)
    number = {name: i for i, name in enumerate(classes)}
    for p, t in zip(predicted, true, strict=True):
        counts[number[t], number[p]] += 1
    return counts
