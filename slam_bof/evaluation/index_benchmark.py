"""The cost of a query to the inverted index, and the recall of revisited places by it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slam_bof.bof import InvertedIndex
from slam_bof.evaluation.cost import Cost
from slam_bof.evaluation.descriptor_runs import Progress
from slam_bof.evaluation.loop_metrics import same_place
from slam_bof.evaluation.place_methods import bag_similarities
from slam_bof.evaluation.retrieval_metrics import retrieval_metrics
from slam_bof.types import Bag, Trajectory

__all__ = ["measure_index", "measure_recall"]

MIN_AGE_FRAMES = 100
"""An answer is at least this many frames older than its query."""
RECALL_AT = (1, 5, 10)
N_MIXED = 10_000
"""Number of different bags in an index; larger indices hold them several times."""
N_QUERIES = 50
"""Number of queries that are timed."""


def measure_recall(
    bags: Sequence[Bag], frame_indices: Sequence[int], reference: Trajectory, n_words: int
) -> dict[str, float | None]:
    """Return recall at 1, 5 and 10 of the frames that revisit a place (``same_place``).

    Every bag is a query against those at least ``MIN_AGE_FRAMES`` frames older. The values are None
    where no frame revisits a place.
    """
    same = same_place(frame_indices, reference, min_age_frames=MIN_AGE_FRAMES)
    index = np.asarray(frame_indices)
    allowed = index[None, :] <= index[:, None] - MIN_AGE_FRAMES
    metrics = retrieval_metrics(bag_similarities(bags, n_words), same, allowed, RECALL_AT)
    return {str(k): metrics.recall_at[k] if metrics else None for k in RECALL_AT}


def measure_index(
    bags: Sequence[Bag], size: int, n_words: int, seed: int, on_progress: Progress
) -> dict[str, float]:
    """Time queries against an index of ``size`` bags, each mixed of two of the given ones."""
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
