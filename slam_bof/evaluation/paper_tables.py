"""The paper's tables 7 to 9: cost of the processes and memory, by method."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import TfIdf, Vocabulary, count_words, pack, unpack
from slam_bof.core import peak_rss_mb
from slam_bof.datasets import LabelledFrame
from slam_bof.evaluation.cost import Cost, one_thread
from slam_bof.evaluation.descriptor_runs import (
    METHODS,
    N_REPEATS,
    DescriptorRun,
    Method,
    Progress,
    choose_frames,
    describe,
)
from slam_bof.evaluation.index_benchmark import measure_index, measure_recall
from slam_bof.ports import Dataset
from slam_bof.scenes import SceneClassifier, classifier_bytes
from slam_bof.types import Bag

__all__ = ["run_bench"]

MIN_DESCRIPTORS = 10
"""A method with fewer descriptors in all frames is left out."""
QUERY_EVERY = 5
"""Recall is measured on every n-th frame."""
INDEXED_METHOD = "BOF 20 layers"
"""The method whose bags fill the large indices."""


def run_bench(
    datasets: Sequence[Dataset],
    *,
    n_frames: int | None = None,
    n_words: int = 1024,
    index_sizes: Sequence[int] = (10_000, 1_000_000),
    seed: int = 0,
    on_progress: Progress = lambda what, done, total: None,
) -> dict[str, Any]:
    """Measure every method on the sequences' frames.

    Parameters
    ----------
    datasets
        Several sequences are a class each. A single one is cut into segments of time, which
        shows the cost of a classification but not its quality.
    n_frames
        Number of frames of each sequence, evenly spaced; by default all.
    n_words
        Number of words of the codebooks; fewer where a method finds fewer descriptors.
    index_sizes
        Numbers of keyframes that a query is timed against.
    seed
        Seed of all random numbers.
    on_progress
        Called with the name of the current task, the number of steps done, and their total.

    Returns
    -------
    dict
        ``methods`` by name (the figures of one column each), ``increases`` (table 8), ``index``
        (cost of a query by number of keyframes), ``left_out`` (reason by method), and the
        sequences, frames and classes measured.

    Raises
    ------
    DatasetError
        If there are too few frames, or some have colour and some have none.
    """
    frames = choose_frames(datasets, n_frames)
    methods, left_out = _methods(datasets)
    columns: dict[str, dict[str, Any]] = {}
    indexed_bags: list[Bag] = []
    n_indexed_words = n_words
    with one_thread():
        reading, runs = describe(frames, methods, on_progress)
        for done, method in enumerate(methods, start=1):
            run = runs.pop(method.name)
            if len(run) < MIN_DESCRIPTORS:
                left_out[method.name] = f"{len(run)} descriptors in all frames"
                continue
            words = min(n_words, len(run), method.max_samples)
            column, bags = _measure(frames, method, run, n_words=words, seed=seed)
            columns[method.name] = column
            if method.name == INDEXED_METHOD:
                indexed_bags, n_indexed_words = bags, words
            on_progress("Codebooks and classifiers", done, len(methods))
        index = {
            str(size): measure_index(indexed_bags, size, n_indexed_words, seed, on_progress)
            for size in (index_sizes if indexed_bags else ())
        }
    return {
        "sequences": [dataset.sequence for dataset in datasets],
        "frames": len(frames),
        "classes": sorted({frame.label for frame in frames}),
        "decode_ms": reading.median_ms,
        "left_out": left_out,
        "methods": columns,
        "increases": _increases(columns),
        "index": index,
        "peak_rss_mb": peak_rss_mb(),
        "seed": seed,
    }


def _methods(datasets: Sequence[Dataset]) -> tuple[list[Method], dict[str, str]]:
    """Return the methods that the sequences have images for, and why others are left out."""
    without = [dataset.sequence for dataset in datasets if dataset.gray(0) is None]
    if not without:
        return list(METHODS), {}
    reason = f"no colour images in {', '.join(without)}"
    left_out = {m.name: reason for m in METHODS if m.plugin != "bof"}
    return [m for m in METHODS if m.name not in left_out], left_out


def _measure(
    frames: Sequence[LabelledFrame],
    method: Method,
    run: DescriptorRun,
    *,
    n_words: int,
    seed: int,
) -> tuple[dict[str, Any], list[Bag]]:
    """Return a column of the tables, and the bags of all frames."""
    codebook, lookup, weighing, bagging = Cost(), Cost(), Cost(), Cost()
    samples = run.samples(method.max_samples, seed)
    with codebook.measure():
        vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(samples)
    words = []
    for values in run.values:
        as_float = run.as_float(values)
        with lookup.measure():
            words.append(vocabulary.lookup(as_float))
    with weighing.measure():
        counts = count_words(words, n_words)
        tf_idf = TfIdf().fit(counts)
        matrix = tf_idf.transform(counts)
    bags = []
    for of_frame in words:
        with bagging.measure():
            bags.append(tf_idf.bag(of_frame))
    training, classification, classifier = _classify(frames, matrix, seed)

    column: dict[str, Any] = {
        **_processes(run, codebook, lookup + weighing, training, classification),
        "describe_ms": run.all_frames.median_ms,
        "bag_ms": 1e3 * float(np.median(np.add(lookup.calls_s, bagging.calls_s))),
        "descriptors": len(run),
        "samples": len(samples),
        "words": n_words,
        "descriptor_bytes": run.nbytes,
        "bag_bytes": matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes,
        "codebook_bytes": vocabulary.words_.nbytes + tf_idf.idf_.nbytes,
        "classifier_bytes": len(classifier_bytes(classifier)),
    }
    if method.plugin == "bof":
        column["recall"] = _recall(frames, bags, n_words)
        column |= _measure_compressed(frames, run, vocabulary, tf_idf, words)
    return column, bags


def _processes(
    run: DescriptorRun, codebook: Cost, represent: Cost, training: Cost, classification: Cost
) -> dict[str, dict[str, float]]:
    """Return the times of the paper's nine processes, the last three of which are sums."""
    one_frame, extraction = run.one_frame, run.all_frames
    costs = (
        Cost(one_frame.cpu_s / N_REPEATS, one_frame.wall_s / N_REPEATS),
        extraction,
        codebook,
        represent,
        training,
        classification,
        extraction + represent,
        codebook + training,
        extraction + represent + classification,
    )
    return {
        "process_cpu_s": {str(k): cost.cpu_s for k, cost in enumerate(costs, start=1)},
        "process_wall_s": {str(k): cost.wall_s for k, cost in enumerate(costs, start=1)},
    }


def _classify(
    frames: Sequence[LabelledFrame], matrix: Any, seed: int
) -> tuple[Cost, Cost, SceneClassifier]:
    training, classification = Cost(), Cost()
    labels = np.array([frame.label for frame in frames])
    with training.measure():
        classifier = SceneClassifier(seed=seed).fit(matrix, labels)
    with classification.measure():
        classifier.predict(matrix)
    return training, classification, classifier


def _measure_compressed(
    frames: Sequence[LabelledFrame],
    run: DescriptorRun,
    vocabulary: Vocabulary,
    tf_idf: TfIdf,
    words: Sequence[NDArray[np.int32]],
) -> dict[str, Any]:
    """Return the size of compressed descriptors, and how many words and recall they keep."""
    packed = [pack(run.as_float(values)) for values in run.values]
    n_values = vocabulary.words_.shape[1]
    again = [vocabulary.lookup(unpack(data, n_values=n_values)) for data in packed]
    return {
        "packed_bytes": sum(map(len, packed)),
        "packed_words_kept": float(np.mean(np.concatenate(again) == np.concatenate(words))),
        "packed_recall": _recall(frames, [tf_idf.bag(found) for found in again], len(tf_idf.idf_)),
    }


def _recall(
    frames: Sequence[LabelledFrame], bags: Sequence[Bag], n_words: int
) -> dict[str, float | None] | None:
    """Return the recall of every ``QUERY_EVERY``-th frame of one sequence with ground truth."""
    dataset = frames[0].dataset
    groundtruth = dataset.groundtruth()
    if groundtruth is None or any(frame.dataset is not dataset for frame in frames):
        return None
    every = QUERY_EVERY if len(frames) == len(dataset) else 1
    indices = [frame.index for frame in frames[::every]]
    return measure_recall(bags[::every], indices, groundtruth, n_words)


def _increases(columns: dict[str, dict[str, Any]]) -> dict[str, dict[str, dict[str, float | None]]]:
    """Return by how many percent SIFT and ORB cost more than BOF (table 8), by process."""
    return {
        f"{initial} to {final}": {
            key.removeprefix("process_").removesuffix("_s") + "_percent": {
                process: 100.0 * (columns[final][key][process] - before) / before
                if before
                else None
                for process, before in columns[initial][key].items()
            }
            for key in ("process_cpu_s", "process_wall_s")
        }
        for final in ("SIFT", "ORB")
        for initial in ("BOF 3 layers", "BOF 20 layers")
        if initial in columns and final in columns
    }
