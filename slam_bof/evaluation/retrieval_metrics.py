"""Metrics of place retrieval: recall at k, average precision, recall at full precision."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["RetrievalMetrics", "retrieval_metrics"]


@dataclass(frozen=True, slots=True)
class RetrievalMetrics:
    """Metrics over the ``n_queries`` queries that have a relevant answer.

    ``recall_at`` is the share of queries with a relevant answer among the first k. The others are
    of each query's best answer, accepted in the order of falling scores: ``average_precision``;
    ``recall_at_full_precision``, the share found before the first wrong answer; and ``curve``,
    recall and precision after each accepted answer.
    """

    n_queries: int
    recall_at: dict[int, float]
    average_precision: float
    recall_at_full_precision: float
    curve: tuple[tuple[float, float], ...]


def retrieval_metrics(
    scores: NDArray[np.floating],
    relevant: NDArray[np.bool_],
    allowed: NDArray[np.bool_],
    ks: Sequence[int] = (1, 5, 10, 20),
) -> RetrievalMetrics | None:
    """Evaluate the ranking of answers by their scores.

    Parameters
    ----------
    scores
        (K, K) score of each answer (column) to each query (row); higher is better. Of equal
        scores the first comes first.
    relevant, allowed
        (K, K) which answers are right, and which may be given at all.
    ks
        Numbers of answers for ``recall_at``.

    Returns
    -------
    RetrievalMetrics or None
        None where no query has a relevant answer.

    Examples
    --------
    >>> scores = np.array([[0, 0, 0], [0.9, 0, 0], [0.5, 0.8, 0]])
    >>> relevant = np.array([[0, 0, 0], [1, 0, 0], [1, 0, 0]], bool)
    >>> retrieval_metrics(scores, relevant, np.tri(3, k=-1, dtype=bool), ks=(1, 2)).recall_at
    {1: 0.5, 2: 1.0}
    """
    relevant = relevant & allowed
    has_relevant = relevant.any(axis=1)
    if not has_relevant.any():
        return None
    ranked = np.where(allowed, scores, -np.inf)
    order = np.argsort(-ranked, axis=1, kind="stable")
    hits = np.take_along_axis(relevant, order, axis=1)[has_relevant]
    # A query without a relevant answer lowers the precision if it is answered.
    answered = allowed.any(axis=1)
    best = ranked[answered].argmax(axis=1)
    best_score = ranked[answered, best]
    right = relevant[answered, best][np.argsort(-best_score, kind="stable")]
    precision = np.cumsum(right) / np.arange(1, len(right) + 1)
    recall = np.cumsum(right) / has_relevant.sum()
    n_before_wrong = len(right) if right.all() else int(right.argmin())
    return RetrievalMetrics(
        n_queries=int(has_relevant.sum()),
        recall_at={k: float(hits[:, :k].any(axis=1).mean()) for k in ks},
        average_precision=float((precision * right).sum() / has_relevant.sum()),
        recall_at_full_precision=float(n_before_wrong / has_relevant.sum()),
        curve=tuple(zip(recall.tolist(), precision.tolist(), strict=True)),
    )
