"""Metrics of place retrieval: recall at k, precision-recall curves, average precision."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.types import Array

__all__ = ["PrecisionRecall", "Recognition", "judge", "precision_recall", "recall_at_k"]


@dataclass(frozen=True, slots=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve as scikit-learn has it: (T + 1,) shares, (T,) thresholds."""

    precision: Array
    recall: Array
    thresholds: Array
    average_precision: float


def recall_at_k(
    ranked: Sequence[Sequence[Hashable]], relevant: Sequence[Collection[Hashable]], k: int
) -> float | None:
    """Return the share of queries with a relevant answer among the first ``k``.

    Queries to which nothing is relevant do not count; None if that leaves none.

    >>> recall_at_k([[3, 1, 2], [5, 4]], [{1}, {9}], k=2)
    0.5
    """
    asked = [(r, set(wanted)) for r, wanted in zip(ranked, relevant, strict=True) if wanted]
    if not asked:
        return None
    return float(np.mean([not wanted.isdisjoint(answers[:k]) for answers, wanted in asked]))


def precision_recall(scores: ArrayLike, is_true: ArrayLike) -> PrecisionRecall | None:
    """Return the precision-recall curve of scores (N,) against truth (N,).

    None where nothing is true, since recall has then no meaning.
    """
    from sklearn.metrics import average_precision_score, precision_recall_curve

    truth = np.asarray(is_true, dtype=bool)
    if not truth.any():
        return None
    precision, recall, thresholds = precision_recall_curve(truth, scores)
    average = float(average_precision_score(truth, scores))
    return PrecisionRecall(precision, recall, np.asarray(thresholds, np.float64), average)


@dataclass(frozen=True, slots=True)
class Recognition:
    """What a score is worth: shares of the ``n_queries`` queries to which an answer is right.

    ``average_precision`` and ``recall_at_full_precision`` are of each query's best answer,
    accepted from the highest score down: the latter is how many right ones come before the
    first wrong one. ``curve`` has recall and precision after each answer accepted.
    """

    n_queries: int
    recall_at: dict[int, float]
    average_precision: float
    recall_at_full_precision: float
    curve: tuple[tuple[float, float], ...]


def judge(
    scores: NDArray[np.floating],
    truth: NDArray[np.bool_],
    allowed: NDArray[np.bool_],
    ks: Sequence[int] = (1, 5, 10, 20),
) -> Recognition | None:
    """Judge scores (K, K), higher is better, by a truth; None where no query has a right answer.

    >>> scores = np.array([[0, 0, 0], [0.9, 0, 0], [0.5, 0.8, 0]])
    >>> truth = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bool)
    >>> judge(scores, truth, np.tri(3, k=-1, dtype=bool), ks=(1, 2)).recall_at
    {1: 0.5, 2: 1.0}
    """
    truth = truth & allowed
    asked = truth.any(axis=1)
    if not asked.any():
        return None
    ranked = np.where(allowed, scores, -np.inf)
    order = np.argsort(-ranked, axis=1, kind="stable")
    hits = np.take_along_axis(truth, order, axis=1)[asked]
    # A query with nothing to find counts against precision, if it is answered.
    answered = allowed.any(axis=1)
    best = ranked[answered].argmax(axis=1)
    best_score = ranked[answered, best]
    right = truth[answered, best][np.argsort(-best_score, kind="stable")]
    precision = np.cumsum(right) / np.arange(1, len(right) + 1)
    recall = np.cumsum(right) / asked.sum()
    n_before_wrong = len(right) if right.all() else int(right.argmin())
    return Recognition(
        n_queries=int(asked.sum()),
        recall_at={k: float(hits[:, :k].any(axis=1).mean()) for k in ks},
        average_precision=float((precision * right).sum() / asked.sum()),
        recall_at_full_precision=float(n_before_wrong / asked.sum()),
        curve=tuple(zip(recall.tolist(), precision.tolist(), strict=True)),
    )
