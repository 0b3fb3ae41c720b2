"""The figures of the paper's tables 7 to 9, by method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof import registry
from slam_bof.bench.cost import Cost, one_thread
from slam_bof.bench.querying import Progress, measure_index, measure_recall
from slam_bof.model import classifier_bytes
from slam_bof.packing import pack, unpack
from slam_bof.ports import Dataset, Descriptor
from slam_bof.scenes import SceneClassifier
from slam_bof.types import Bag
from slam_bof.vocabulary import TfIdf, Vocabulary, count_words

__all__ = ["METHODS", "Method", "run_bench"]

BLOCK = 25
"""Frames that one method describes before it is the next one's turn."""
N_REPEATS = 10
"""How often process 1 describes one frame."""
N_STRETCHES = 5
"""Classes that a single sequence is cut into."""
QUERY_EVERY = 5
"""Recall is measured on each so many frames."""


@dataclass(frozen=True, slots=True)
class Method:
    """A column of the tables: a descriptor plug-in, and the samples its codebook sees at most."""

    name: str
    plugin: str
    options: Mapping[str, Any]
    max_samples: int


METHODS = (
    Method("BOF 3 layers", "bof", {"layers": {"n_layers": 3}}, 34_000),
    Method("BOF 20 layers", "bof", {"layers": {"n_layers": 20}}, 190_000),
    Method("SIFT", "sift", {}, 150_000),
    Method("ORB", "orb", {}, 150_000),
)
"""The paper's three, with its numbers of samples (section 4.4), and ORB."""


@dataclass(frozen=True, slots=True)
class _Frame:
    dataset: Dataset
    index: int
    label: str


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
        Several are a class each; a single one is cut into stretches of time, whose
        classification costs what any does, but tells nothing.
    n_frames
        Take so many, evenly spaced, of each sequence; by default all.
    n_words
        Of the codebooks.
    index_sizes
        Numbers of keyframes that a query is timed against.
    on_progress
        Called with what is being done, how much of it is, and of how much.

    Returns
    -------
    dict
        ``frames``, ``decode_ms``, ``left_out`` (methods and why), ``methods`` by name (the
        figures of one column) and ``index`` (of a query, by number of keyframes).

    Raises
    ------
    ValueError
        If the frames give fewer descriptors than words.
    """
    frames = _frames(datasets, n_frames)
    methods, left_out = list(METHODS), {}
    if frames[0].dataset.gray(frames[0].index) is None:
        left_out = {m.name: "the sequence has no colour images" for m in METHODS[2:]}
        methods = list(METHODS[:2])
    with one_thread():
        decode, described = _describe(frames, methods, on_progress)
        columns: dict[str, dict[str, Any]] = {}
        bags: dict[str, list[Bag]] = {}
        for done, method in enumerate(methods):
            on_progress(f"Words of {method.name}", done, len(methods))
            columns[method.name], bags[method.name] = _measure(
                frames, method, *described.pop(method.name), n_words=n_words, seed=seed
            )
        on_progress("Words", len(methods), len(methods))
        index = {
            str(size): measure_index(bags["BOF 20 layers"], size, n_words, seed, on_progress)
            for size in index_sizes
        }
    return {
        "sequences": [dataset.sequence for dataset in datasets],
        "frames": len(frames),
        "classes": sorted({frame.label for frame in frames}),
        "words": n_words,
        "decode_ms": decode.median_ms,
        "left_out": left_out,
        "methods": columns,
        "index": index,
        "seed": seed,
    }


def _frames(datasets: Sequence[Dataset], n_frames: int | None) -> list[_Frame]:
    frames = []
    for dataset in datasets:
        n = min(n_frames or len(dataset), len(dataset))
        for k, index in enumerate(np.linspace(0, len(dataset) - 1, n).round().astype(int)):
            label = f"stretch {k * N_STRETCHES // n}" if len(datasets) == 1 else dataset.sequence
            frames.append(_Frame(dataset, int(index), label))
    return frames


def _describe(
    frames: Sequence[_Frame], methods: Sequence[Method], on_progress: Progress
) -> tuple[Cost, dict[str, tuple[Descriptor, Cost, list[NDArray[Any]]]]]:
    """Describe all frames by all methods; values that fit are kept in 8 bits."""
    decode = Cost()
    described: dict[str, tuple[Descriptor, Cost, list[NDArray[Any]]]] = {
        m.name: (registry.build("descriptors", m.plugin, m.options), Cost(), []) for m in methods
    }
    needs_gray = any(descriptor.needs_gray for descriptor, _, _ in described.values())
    for start in range(0, len(frames), BLOCK):
        images = []
        for item in frames[start : start + BLOCK]:
            with decode.measure():
                gray = item.dataset.gray(item.index) if needs_gray else None
                images.append((item.dataset.frame(item.index), gray))
        for descriptor, cost, values in described.values():
            for frame, gray in images:
                with cost.measure():
                    found = descriptor.describe(frame, gray)
                bytes_ = found.astype(np.uint8)
                values.append(bytes_ if np.array_equal(bytes_, found) else found)
        on_progress("Frames", start + len(images), len(frames))
    return decode, described


def _measure(
    frames: Sequence[_Frame],
    method: Method,
    descriptor: Descriptor,
    extraction: Cost,
    described: list[NDArray[Any]],
    *,
    n_words: int,
    seed: int,
) -> tuple[dict[str, Any], list[Bag]]:
    """Return a column of the tables, and the bags of all frames."""
    one, codebook, represent, training, classification = (Cost() for _ in range(5))
    middle = frames[len(frames) // 2]
    frame, gray = middle.dataset.frame(middle.index), middle.dataset.gray(middle.index)
    for _ in range(N_REPEATS):
        with one.measure():
            descriptor.describe(frame, gray)

    values = [_numbers(found, descriptor) for found in described]
    samples = np.concatenate(values)
    if len(samples) > method.max_samples:
        chosen = np.random.default_rng(seed).choice(len(samples), method.max_samples, False)
        samples = samples[np.sort(chosen)]
    with codebook.measure():
        vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(samples)

    with represent.measure():
        counts = count_words([vocabulary.lookup(found) for found in values], n_words)
        tf_idf = TfIdf().fit(counts)
        matrix = tf_idf.transform(counts)
    labels = np.array([item.label for item in frames])
    with training.measure():
        classifier = SceneClassifier(seed=seed).fit(matrix, labels)
    with classification.measure():
        classifier.predict(matrix)

    bag_cost, bags = Cost(), []
    for found in values:
        with bag_cost.measure():
            bags.append(tf_idf.bag(vocabulary.lookup(found)))
    descriptor_bytes = sum(_stored_bytes(found, descriptor) for found in described)
    processes = {
        1: Cost(one.cpu_s / N_REPEATS, one.wall_s / N_REPEATS),
        2: extraction,
        3: codebook,
        4: represent,
        5: training,
        6: classification,
        7: extraction + represent,
        8: codebook + training,
        9: extraction + represent + classification,
    }
    column: dict[str, Any] = {
        "process_cpu_s": {str(k): cost.cpu_s for k, cost in processes.items()},
        "process_wall_s": {str(k): cost.wall_s for k, cost in processes.items()},
        "describe_ms": extraction.median_ms,
        "bag_ms": bag_cost.median_ms,
        "descriptors": sum(map(len, values)),
        "samples": len(samples),
        "descriptor_bytes": descriptor_bytes,
        "bag_bytes": matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes,
        "codebook_bytes": vocabulary.words_.nbytes + tf_idf.idf_.nbytes,
        "classifier_bytes": len(classifier_bytes(classifier)),
    }
    if method.plugin == "bof":
        packed = [pack(found) for found in values]
        column["packed_bytes"] = sum(map(len, packed))
        again = [vocabulary.lookup(unpack(data)) for data in packed]
        column["packed_words_kept"] = float(
            np.mean(np.concatenate(again) == np.concatenate([vocabulary.lookup(v) for v in values]))
        )
        packed_bags = [tf_idf.bag(words) for words in again]
        for key, kept in (("recall", bags), ("packed_recall", packed_bags)):
            column[key] = _recall(frames, kept, n_words)
    return column, bags


def _numbers(found: NDArray[Any], descriptor: Descriptor) -> NDArray[np.float32]:
    """Return descriptors as k-means takes them."""
    values = np.unpackbits(found, axis=1) if descriptor.is_binary else found
    return values.astype(np.float32)


def _stored_bytes(found: NDArray[Any], descriptor: Descriptor) -> int:
    """Return the size of descriptors as the method gives them: bits, or float32."""
    return found.size * (1 if descriptor.is_binary else 4)


def _recall(
    frames: Sequence[_Frame], bags: Sequence[Bag], n_words: int
) -> dict[str, float | None] | None:
    """Return the recall of each ``QUERY_EVERY``-th frame of one sequence with ground truth."""
    dataset = frames[0].dataset
    groundtruth = dataset.groundtruth()
    if groundtruth is None or any(item.dataset is not dataset for item in frames):
        return None
    every = QUERY_EVERY if len(frames) == len(dataset) else 1
    indices = [item.index for item in frames[::every]]
    return measure_recall(bags[::every], indices, groundtruth, n_words)
