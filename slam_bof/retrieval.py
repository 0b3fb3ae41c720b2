"""Compare descriptors by how often they find a place again, by the protocol of ``recognition``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof import model as models
from slam_bof import registry
from slam_bof.bench.cost import Cost, one_thread
from slam_bof.bench.describing import Described
from slam_bof.errors import DatasetError
from slam_bof.index import InvertedIndex
from slam_bof.ports import Dataset, Descriptor
from slam_bof.recognition import ProtocolParams, eligible, judge, truths
from slam_bof.types import Bag
from slam_bof.vocabulary import TfIdf, Vocabulary, count_words

__all__ = ["evaluate_places", "score_rows"]

MAX_SAMPLES = 150_000
"""Local features that a vocabulary is learnt of at most."""

Progress = Callable[[str, int, int], None]
Bags = tuple[Vocabulary, TfIdf]


def evaluate_places(
    datasets: Sequence[Dataset],
    names: Sequence[str],
    *,
    training: Sequence[Dataset] = (),
    params: ProtocolParams | None = None,
    n_words: int = 1024,
    seed: int = 0,
    on_progress: Progress = lambda what, done, total: None,
) -> list[dict[str, Any]]:
    """Judge descriptor plug-ins on sequences with ground truth.

    Parameters
    ----------
    datasets
        Each is judged by itself.
    names
        The plug-ins.
    training
        Sequences whose frames vocabularies are learnt of. Without any, ``bof`` has the model that
        comes along, and other local features are left out.

    Returns
    -------
    list of dict
        One for each sequence and descriptor: ``sequence``, ``descriptor``, ``describe_ms`` (CPU,
        median), ``bytes_per_frame``, and for each truth, ``pose`` and ``overlap``, the figures of
        ``Recognition``, or None where nothing comes back; or else ``left_out``, saying why.

    Raises
    ------
    DatasetError
        If a sequence has no ground truth, or lacks some of its poses.
    """
    params = params or ProtocolParams()
    rows: list[dict[str, Any]] = []
    vocabularies: dict[str, Bags] = {}
    with one_thread():
        for dataset in datasets:
            indices = list(range(0, len(dataset), params.every))
            right = _truths(dataset, indices, params)
            allowed = eligible(indices, params)
            for name in names:
                descriptor: Descriptor = registry.build("descriptors", name)
                row: dict[str, Any] = {"sequence": dataset.sequence, "descriptor": name}
                rows.append(row)
                missing = _missing(name, descriptor, dataset, training)
                if missing:
                    row["left_out"] = missing
                    continue
                if descriptor.comparison == "bag" and name not in vocabularies:
                    vocabularies[name] = _learn(name, descriptor, training, n_words, seed)
                what = f"{dataset.sequence} {name}"
                cost, found = _describe(descriptor, dataset, indices, what, on_progress)
                if descriptor.comparison == "bag":
                    bags = [_bag(found.numbers(v), *vocabularies[name]) for v in found.values]
                    scores = _score_bags(bags, len(vocabularies[name][1].idf_))
                    n_bytes = sum(bag.words.nbytes + bag.weights.nbytes for bag in bags)
                else:
                    scores = score_rows(np.concatenate(found.values), descriptor.comparison)
                    n_bytes = found.nbytes
                row["describe_ms"] = cost.median_ms
                row["bytes_per_frame"] = n_bytes / len(indices)
                for kind, truth in right.items():
                    judged = judge(scores, truth, allowed)
                    row[kind] = asdict(judged) if judged else None
    return rows


def score_rows(values: NDArray[Any], comparison: str) -> NDArray[np.float32]:
    """Return how alike rows (K, D) are, each to each, (K, K); the most alike are highest."""
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


def _score_bags(bags: Sequence[Bag], n_words: int) -> NDArray[np.float32]:
    index = InvertedIndex(n_words)
    for bag in bags:
        index.add(bag)
    return np.stack([index.scores(bag) for bag in bags])


def _truths(
    dataset: Dataset, indices: list[int], params: ProtocolParams
) -> dict[str, NDArray[np.bool_]]:
    groundtruth = dataset.groundtruth()
    if groundtruth is None:
        raise DatasetError(f"{dataset.sequence}: found no ground truth, expected poses to judge by")
    if not np.isfinite(groundtruth.poses[indices]).all():
        raise DatasetError(f"{dataset.sequence}: found frames without pose, expected all to have")
    frames = [dataset.frame(index) for index in indices]
    return truths(frames, indices, groundtruth, params)


def _missing(
    name: str, descriptor: Descriptor, dataset: Dataset, training: Sequence[Dataset]
) -> str | None:
    """Say why a descriptor cannot be judged here, if so."""
    if descriptor.comparison == "bag" and name != "bof" and not training:
        return "needs sequences to learn words of"
    if descriptor.needs_gray:
        dark = [other.sequence for other in (dataset, *training) if other.gray(0) is None]
        if dark:
            return f"no colour images in {', '.join(dark)}"
    return None


def _describe(
    descriptor: Descriptor,
    dataset: Dataset,
    indices: Sequence[int],
    what: str,
    on_progress: Progress,
) -> tuple[Cost, Described]:
    cost, found = Cost(), Described(descriptor)
    for done, index in enumerate(indices, start=1):
        frame = dataset.frame(index)
        gray = dataset.gray(index) if descriptor.needs_gray else None
        with cost.measure():
            values = descriptor.describe(frame, gray)
        found.keep(values)
        on_progress(what, done, len(indices))
    return cost, found


def _learn(
    name: str,
    descriptor: Descriptor,
    training: Sequence[Dataset],
    n_words: int,
    seed: int,
) -> Bags:
    """Learn words and idf of the training sequences, or take the shipped ones."""
    if not training:
        model = models.load_default()
        return model.vocabulary, model.tf_idf
    found = Described(descriptor)
    for dataset in training:
        for index in range(len(dataset)):
            gray = dataset.gray(index) if descriptor.needs_gray else None
            found.keep(descriptor.describe(dataset.frame(index), gray))
    if len(found) < n_words:
        sequences = ", ".join(dataset.sequence for dataset in training)
        raise DatasetError(
            f"{sequences}: found {len(found)} descriptors of {name}, expected at least {n_words}"
        )
    vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(found.samples(MAX_SAMPLES, seed))
    words = [vocabulary.lookup(found.numbers(values)) for values in found.values]
    return vocabulary, TfIdf().fit(count_words(words, n_words))


def _bag(values: NDArray[np.float32], vocabulary: Vocabulary, tf_idf: TfIdf) -> Bag:
    return tf_idf.bag(vocabulary.lookup(values))
