"""Benchmark of place recognition: methods on sequences, by the protocol of ``place_protocol``."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from types import MappingProxyType
from typing import Any

import joblib

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
    n_jobs: int | None = 1,
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
    n_jobs
        Number of sequences at a time, each in a process of its own; None for that of the cluster
        of ``core.on_cluster``. Recall does not depend on it.
    on_progress
        Called with the name of the current task, the number of steps done, and their total; not
        with several jobs.
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
    with one_thread():
        vocabularies = _learn_vocabularies(datasets, names, training, options, n_words, seed)
    evaluate = partial(
        _evaluate_sequence,
        names=names,
        params=params or ProtocolParams(),
        training=training,
        vocabularies=vocabularies,
        options=dict(options),
        recogniser=recogniser,
        odometry=odometry,
        seed=seed,
        on_progress=on_progress if n_jobs == 1 else _ignore,
    )
    rows: list[dict[str, Any]] = []
    jobs = map(joblib.delayed(evaluate), datasets)
    for found in joblib.Parallel(n_jobs=n_jobs, return_as="generator")(jobs):
        for queries, scores in found:
            if isinstance(scores, MethodScores):
                on_scores(queries, scores)
                rows.append(_row(queries, scores))
            else:
                rows.append(scores)
    return rows


def _evaluate_sequence(
    dataset: Dataset,
    names: Sequence[str],
    params: ProtocolParams,
    training: Sequence[Dataset],
    vocabularies: Mapping[str, WeightedVocabulary],
    options: Mapping[str, Any],
    recogniser: RecogniserParams | None,
    odometry: str,
    seed: int,
    on_progress: Progress,
) -> list[tuple[PlaceQueries, MethodScores | dict[str, Any]]]:
    """Return the scores of each method on a sequence, or the row of one that is left out."""
    found: list[tuple[PlaceQueries, MethodScores | dict[str, Any]]] = []
    with one_thread():
        queries = PlaceQueries.of(dataset, params)
        for name in names:
            if name == RECOGNISER:
                place_recogniser = PlaceRecogniser(recogniser, seed=seed)
                tracker = registry.build("odometry", odometry)
                scores = score_recogniser(place_recogniser, tracker, queries, on_progress)
                found += [(queries, one) for one in scores]
                continue
            descriptor: Descriptor = registry.build("descriptors", name, options.get(name, {}))
            if reason := explain_omission(name, descriptor, dataset, training):
                row = {"sequence": dataset.sequence, "descriptor": name, "left_out": reason}
                found.append((queries, row))
                continue
            words = vocabularies.get(name)
            found.append((queries, score_descriptor(name, descriptor, words, queries, on_progress)))
    return found


def _learn_vocabularies(
    datasets: Sequence[Dataset],
    names: Sequence[str],
    training: Sequence[Dataset],
    options: Mapping[str, Any],
    n_words: int,
    seed: int,
) -> dict[str, WeightedVocabulary]:
    """Return the vocabulary of each method that needs one and is evaluated on some sequence."""
    learned = {}
    for name in names:
        if name == RECOGNISER:
            continue
        descriptor: Descriptor = registry.build("descriptors", name, options.get(name, {}))
        if descriptor.comparison == "bag" and not all(
            explain_omission(name, descriptor, dataset, training) for dataset in datasets
        ):
            learned[name] = train_vocabulary(name, descriptor, training, n_words=n_words, seed=seed)
    return learned


def _ignore(what: str, done: int, total: int) -> None:
    """Show no progress: the process has no terminal."""


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
