"""How similar a method finds each two frames of a sequence, and what that costs.

A method is a descriptor plug-in, whose frames are compared as its ``comparison`` says, or the
place recogniser, with and without geometric alignment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import InvertedIndex, TfIdf, Vocabulary
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost
from slam_bof.evaluation.descriptor_runs import DescriptorRun, learn_vocabulary
from slam_bof.evaluation.place_protocol import PlaceQueries
from slam_bof.places import PlaceRecogniser
from slam_bof.ports import Dataset, Descriptor, Odometry
from slam_bof.scenes import model as models
from slam_bof.types import Bag, Pose

__all__ = [
    "RECOGNISER",
    "MethodScores",
    "bag_similarities",
    "explain_omission",
    "hamming_similarities",
    "row_similarities",
    "score_descriptor",
    "score_recogniser",
    "train_vocabulary",
]

RECOGNISER = "recogniser"
"""Name of the place recogniser (``slam_bof.PlaceRecogniser``) among the methods."""
UNALIGNED_PENALTY = 10.0
"""Subtracted from the scores of views that were not aligned, to rank them below all others."""

Progress = Callable[[str, int, int], None]
WeightedVocabulary = tuple[Vocabulary, TfIdf]


@dataclass(frozen=True, slots=True, eq=False)
class MethodScores:
    """Similarity of each two frames by a method, ``scores`` (K, K), and its cost.

    ``describe`` is the cost of describing frames, ``query_ms`` the CPU time in milliseconds of
    comparing a frame with all others, and ``n_bytes`` the size of all descriptions.
    """

    method: str
    scores: NDArray[np.float32]
    describe: Cost
    query_ms: float
    n_bytes: int


def explain_omission(
    name: str, descriptor: Descriptor, dataset: Dataset, training: Sequence[Dataset]
) -> str | None:
    """Return why a descriptor cannot be evaluated on a sequence; None if it can."""
    if descriptor.comparison == "bag" and name != "bof" and not training:
        return "needs sequences to learn words of"
    if descriptor.needs_gray:
        without = [other.sequence for other in (dataset, *training) if other.gray(0) is None]
        if without:
            return f"no colour images in {', '.join(without)}"
    return None


def train_vocabulary(
    name: str, descriptor: Descriptor, training: Sequence[Dataset], *, n_words: int, seed: int
) -> WeightedVocabulary:
    """Learn words and idf on training sequences; without any, return the default model's."""
    if not training:
        model = models.resolve()
        return model.vocabulary, model.tf_idf
    run = DescriptorRun(descriptor)
    for dataset in training:
        for index in range(len(dataset)):
            gray = dataset.gray(index) if descriptor.needs_gray else None
            run.keep(descriptor.describe(dataset.frame(index), gray))
    try:
        vocabulary, _ = learn_vocabulary(run, name, n_words=n_words, seed=seed)
    except DatasetError as error:
        sequences = ", ".join(dataset.sequence for dataset in training)
        raise DatasetError(f"{sequences}: {error}") from None
    return vocabulary


def score_descriptor(
    name: str,
    descriptor: Descriptor,
    vocabulary: WeightedVocabulary | None,
    queries: PlaceQueries,
    on_progress: Progress,
) -> MethodScores:
    """Describe the frames by a plug-in and compare each with all others.

    ``vocabulary`` is needed by descriptors whose comparison is ``bag``.
    """
    dataset, indices = queries.dataset, queries.indices
    describe, query, run = Cost(), Cost(), DescriptorRun(descriptor)
    for done, index in enumerate(indices, start=1):
        frame = dataset.frame(index)
        gray = dataset.gray(index) if descriptor.needs_gray else None
        with describe.measure():
            values = descriptor.describe(frame, gray)
        run.keep(values)
        on_progress(f"{dataset.sequence} {name}", done, len(indices))
    if descriptor.comparison == "hamming":
        n_bytes = run.nbytes
        with query.measure():
            scores = hamming_similarities(run.values)
    elif vocabulary is None:
        rows, n_bytes = np.concatenate(run.values), run.nbytes
        with query.measure():
            scores = row_similarities(rows, descriptor.comparison)
    else:
        words, tf_idf = vocabulary
        bags = [tf_idf.bag(words.lookup(run.as_float(values))) for values in run.values]
        n_bytes = sum(bag.words.nbytes + bag.weights.nbytes for bag in bags)
        with query.measure():
            scores = bag_similarities(bags, len(tf_idf.idf_))
    return MethodScores(name, scores, describe, 1e3 * query.cpu_s / len(indices), n_bytes)


def score_recogniser(
    recogniser: PlaceRecogniser, odometry: Odometry, queries: PlaceQueries, on_progress: Progress
) -> list[MethodScores]:
    """Score the place recogniser without alignment, and with it."""
    dataset, indices = queries.dataset, queries.indices
    describe, retrieve, recognise = Cost(), Cost(), Cost()
    unaligned = np.full(queries.allowed.shape, -np.inf, np.float32)
    aligned = unaligned.copy()
    is_query = set(indices)
    for index in range(indices[-1] + 1):
        frame = dataset.frame(index)
        T_odom_camera: Pose = odometry.process(frame)
        if index not in is_query:
            continue
        with describe.measure():
            query = recogniser.add(frame, T_odom_camera)
        n_views = int(queries.allowed[query].sum())
        with retrieve.measure():
            shortlist = recogniser.retrieve(query, n_views)
        with recognise.measure():
            matches = recogniser.recognise(query, n_views)
        unaligned[query, :n_views] = shortlist.scores
        aligned[query, :n_views] = shortlist.scores - UNALIGNED_PENALTY
        for match in matches:
            aligned[query, match.view_id] = match.score
        on_progress(f"{dataset.sequence} {RECOGNISER}", query + 1, len(indices))
    n_bytes = recogniser.nbytes
    return [
        MethodScores(f"{RECOGNISER}, unaligned", unaligned, describe, retrieve.median_ms, n_bytes),
        MethodScores(RECOGNISER, aligned, describe, recognise.median_ms, n_bytes),
    ]


def row_similarities(values: NDArray[Any], comparison: str) -> NDArray[np.float32]:
    """Return the similarity of each two rows of (K, D), as (K, K); higher is more similar.

    ``comparison`` is that of ``ports.Descriptor``: ``cosine``, ``l1`` or ``equal``.
    """
    if comparison == "cosine":
        values = values.astype(np.float32)
        lengths = np.linalg.norm(values, axis=1, keepdims=True)
        unit = values / np.where(lengths > 0, lengths, 1.0)
        return np.asarray(unit @ unit.T)
    if comparison == "l1":
        values = values.astype(np.float32)
        return np.stack([-np.abs(values - row).mean(axis=1) for row in values])
    if comparison == "equal":
        return np.stack([(values == row).mean(axis=1, dtype=np.float32) for row in values])
    raise ValueError(f"comparison must be cosine, l1 or equal, got {comparison!r}")


def hamming_similarities(codes: Sequence[NDArray[np.uint8]]) -> NDArray[np.float32]:
    """Return the similarity of each two frames by their local codes, (K, K).

    A query's code counts by the share of bits that it has in common with the nearest code of the
    other frame. A frame without codes is similar to none.

    Parameters
    ----------
    codes
        For each frame (M, B) packed bits; M may differ.
    """
    counts = np.array([len(of_frame) for of_frame in codes])
    n_bytes = max((of_frame.shape[1] for of_frame in codes), default=0)
    rows = np.zeros((counts.sum(), -(-n_bytes // 8) * 8), np.uint8)
    rows[:, :n_bytes] = np.concatenate([np.empty((0, n_bytes), np.uint8), *codes])
    words = rows.view(np.uint64)
    found = np.flatnonzero(counts)
    ends = np.cumsum(counts)
    scores = np.zeros((len(codes), len(codes)), np.float32)
    for k in found:
        own = words[ends[k] - counts[k] : ends[k], None]
        distance = np.bitwise_count(own ^ words).sum(axis=2, dtype=np.uint16)
        nearest = np.minimum.reduceat(distance, (ends - counts)[found], axis=1)
        scores[k, found] = 1.0 - nearest.mean(axis=0) / (8 * n_bytes)
    return scores


def bag_similarities(bags: Sequence[Bag], n_words: int) -> NDArray[np.float32]:
    """Return the similarity of each two of K bags of words, (K, K), by the inverted index."""
    index = InvertedIndex(n_words)
    for bag in bags:
        index.add(bag)
    return np.stack([index.scores(bag) for bag in bags])
