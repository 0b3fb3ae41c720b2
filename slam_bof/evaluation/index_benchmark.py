"""What a query costs, and how often it finds the place."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_bof import evaluation
from slam_bof.bof import InvertedIndex
from slam_bof.evaluation.cost import Cost
from slam_bof.evaluation.descriptor_runs import Progress
from slam_bof.types import Bag, Trajectory

__all__ = ["measure_index", "measure_recall"]

MIN_AGE_FRAMES = 100
N_MIXED = 10_000
N_QUERIES = 50


def measure_recall(
    bags: Sequence[Bag], frame_indices: Sequence[int], reference: Trajectory, n_words: int
) -> dict[str, float | None]:
    """Return recall@1, 5 and 10 of the frames that come back to a place.

    Every bag is a query against those at least ``MIN_AGE_FRAMES`` older; what is the same
    place says ``evaluation.same_place``. None where no frame comes back.
    """
    same = evaluation.same_place(frame_indices, reference, min_age_frames=MIN_AGE_FRAMES)
    index = InvertedIndex(n_words)
    ranked = []
    for query, bag in enumerate(bags):
        n_old = sum(i <= frame_indices[query] - MIN_AGE_FRAMES for i in frame_indices[:query])
        scores = index.scores(bag)[:n_old]
        ranked.append(np.argsort(-scores, kind="stable").tolist())
        index.add(bag)
    relevant = [np.flatnonzero(row).tolist() for row in same]
    return {str(k): evaluation.recall_at_k(ranked, relevant, k) for k in (1, 5, 10)}


def measure_index(
    bags: Sequence[Bag], size: int, n_words: int, seed: int, on_progress: Progress
) -> dict[str, float]:
    """Time queries against so many bags, each with words of two of the given ones."""
    random = np.random.default_rng(seed)
    halves = random.integers(len(bags), size=(N_MIXED, 2))
    mixed = [_mix(bags[a], bags[b], random) for a, b in halves]
    index = InvertedIndex(n_words)
    adding, query = Cost(), Cost()
    for start in range(0, size, len(mixed)):
        part = mixed[: size - start]
        with adding.measure():
            for bag in part:
                index.add(bag)
        on_progress(f"Index of {size}", start + len(part), size)
    for k in np.linspace(0, len(bags) - 1, N_QUERIES).round().astype(int):
        with query.measure():
            index.scores(bags[k])
    return {
        "query_ms": query.median_ms,
        "add_ms": 1e3 * adding.cpu_s / size,
        "bytes_per_keyframe": index.nbytes / size,
    }


def _mix(a: Bag, b: Bag, random: np.random.Generator) -> Bag:
    """Return a bag with half of the words of each of two."""
    weights: dict[int, float] = {}
    for bag in (a, b):
        half = random.permutation(len(bag.words))[: (len(bag.words) + 1) // 2]
        weights |= dict(zip(bag.words[half].tolist(), bag.weights[half].tolist(), strict=True))
    words = np.array(sorted(weights), np.int32)
    values = np.array([weights[word] for word in words.tolist()], np.float32)
    return Bag(words, values / values.sum() if len(values) else values)
