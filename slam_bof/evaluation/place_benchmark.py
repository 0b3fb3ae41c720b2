"""Benchmark of place recognition: methods on sequences, by the protocol of ``place_protocol``."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from types import MappingProxyType
from typing import Any

from slam_bof.core import registry
from slam_bof.evaluation.cost import one_thread
from slam_bof.evaluation.place_methods import (
    RECOGNISER,
    MethodScores,
    Progress,
    WeightedVocabulary,
    explain_omission,
    score_descriptor,
    score_recogniser,
    train_vocabulary,
)
from slam_bof.evaluation.place_protocol import PlaceQueries, ProtocolParams
from slam_bof.evaluation.retrieval_metrics import retrieval_metrics
from slam_bof.places import PlaceRecogniser, RecogniserParams
from slam_bof.ports import Dataset, Descriptor

__all__ = ["evaluate_places"]

OnScores = Callable[[PlaceQueries, MethodScores], None]


def evaluate_places(
    datasets: Sequence[Dataset],
    names: Sequence[str],
    *,
    training: Sequence[Dataset] = (),
    params: ProtocolParams | None = None,
    n_words: int = 1024,
    options: Mapping[str, Any] = MappingProxyType({}),
    recogniser: RecogniserParams | None = None,
    odometry: str = "kiss-icp",
    seed: int = 0,
    on_progress: Progress = lambda what, done, total: None,
    on_scores: OnScores = lambda queries, scores: None,
) -> list[dict[str, Any]]:
    """Evaluate descriptor plug-ins, and the recogniser, on sequences with ground truth.

    Parameters
    ----------
    datasets
        The sequences; each is evaluated by itself.
    names
        Names of descriptor plug-ins; ``RECOGNISER`` is evaluated before and after alignment.
    training
        Sequences to learn vocabularies on. Without any, ``bof`` uses the default model's
        vocabulary, and other local features are left out.
    params
        Parameters of the protocol.
    n_words
        Number of words of each vocabulary.
    options
        Options of descriptor plug-ins, by name.
    recogniser, odometry
        Parameters of the recogniser, and the odometry plug-in that gives it poses.
    seed
        Seed of all random numbers.
    on_progress
        Called with the name of the current task, the number of steps done, and their total.
    on_scores
        Called with the queries of each sequence and the scores of each method.

    Returns
    -------
    list of dict
        One for each sequence and method: ``sequence``, ``descriptor``, ``describe_ms`` and
        ``query_ms`` (CPU, medians), ``bytes_per_frame``, and for each truth, ``pose`` and
        ``overlap``, the fields of ``RetrievalMetrics``, or None where no frame revisits a place.
        Methods that cannot be evaluated have ``left_out`` instead, with the reason.

    Raises
    ------
    DatasetError
        If a sequence has no ground truth, or no query has a true pose.
    """
    rows: list[dict[str, Any]] = []
    vocabularies: dict[str, WeightedVocabulary] = {}

    def score(name: str, queries: PlaceQueries) -> Iterable[MethodScores]:
        if name == RECOGNISER:
            place_recogniser = PlaceRecogniser(recogniser, seed=seed)
            tracker = registry.build("odometry", odometry)
            return score_recogniser(place_recogniser, tracker, queries, on_progress)
        descriptor: Descriptor = registry.build("descriptors", name, options.get(name, {}))
        reason = explain_omission(name, descriptor, queries.dataset, training)
        if reason:
            sequence = queries.dataset.sequence
            rows.append({"sequence": sequence, "descriptor": name, "left_out": reason})
            return []
        if descriptor.comparison == "bag" and name not in vocabularies:
            vocabularies[name] = train_vocabulary(
                name, descriptor, training, n_words=n_words, seed=seed
            )
        vocabulary = vocabularies.get(name)
        return [score_descriptor(name, descriptor, vocabulary, queries, on_progress)]

    with one_thread():
        for dataset in datasets:
            queries = PlaceQueries.of(dataset, params or ProtocolParams())
            for name in names:
                for scores in score(name, queries):
                    on_scores(queries, scores)
                    rows.append(_row(queries, scores))
    return rows


def _row(queries: PlaceQueries, scores: MethodScores) -> dict[str, Any]:
    """Return the figures of a method on a sequence."""
    row: dict[str, Any] = {
        "sequence": queries.dataset.sequence,
        "descriptor": scores.method,
        "describe_ms": scores.describe.median_ms,
        "query_ms": scores.query_ms,
        "bytes_per_frame": scores.n_bytes / len(queries.indices),
    }
    for kind, relevant in queries.relevant.items():
        metrics = retrieval_metrics(scores.scores, relevant, queries.allowed)
        row[kind] = asdict(metrics) if metrics else None
    return row
