"""Describe the same frames by several methods, in turns, and keep their descriptors and cost."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import TfIdf, Vocabulary, count_words
from slam_bof.core import registry
from slam_bof.datasets import LabelledFrame
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import Cost
from slam_bof.ports import Dataset, Descriptor

__all__ = [
    "METHODS",
    "DescriptorRun",
    "Method",
    "Progress",
    "choose_frames",
    "describe",
    "learn_vocabulary",
]

BLOCK_SIZE = 25
"""Number of frames that one method describes before the next one does."""
N_REPEATS = 10
"""Number of times that the paper's process 1 describes one frame."""
MAX_SAMPLES = 150_000
"""Largest number of local features that ``learn_vocabulary`` learns words of."""
N_SEGMENTS = 5
"""Number of segments, a class each, that a single sequence is cut into if it is long enough."""

Progress = Callable[[str, int, int], None]
"""Called with the name of the current task, the number of steps done, and their total."""


@dataclass(frozen=True, slots=True)
class Method:
    """A column of the tables: a descriptor plug-in with its options.

    ``max_samples`` is the largest number of descriptors that its codebook is learnt of.
    """

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


@dataclass(frozen=True, slots=True, eq=False)
class DescriptorRun:
    """The descriptors of all frames by one method, and what they cost.

    ``values`` has the descriptors of each frame, as bytes where these hold them exactly: SIFT's
    are whole numbers, and a thousand frames of them would fill half a gigabyte as float32.
    ``one_frame`` is the cost of describing one frame ``N_REPEATS`` times, ``all_frames`` of
    describing each once.
    """

    descriptor: Descriptor
    one_frame: Cost = field(default_factory=Cost)
    all_frames: Cost = field(default_factory=Cost)
    values: list[NDArray[Any]] = field(default_factory=list)

    def __len__(self) -> int:
        """Return the number of descriptors."""
        return sum(map(len, self.values))

    @property
    def nbytes(self) -> int:
        """Size in bytes of the descriptors as the method returns them: bits, or float32."""
        size = 1 if self.descriptor.is_binary else 4
        return sum(values.size for values in self.values) * size

    def keep(self, values: NDArray[Any]) -> None:
        """Keep a frame's descriptors."""
        whole = values.astype(np.uint8)
        self.values.append(whole if np.array_equal(whole, values) else values)

    def as_float(self, values: NDArray[Any]) -> NDArray[np.float32]:
        """Return descriptors as k-means needs them: (M, D) float32, a bit as 0 or 1."""
        unpacked = np.unpackbits(values, axis=1) if self.descriptor.is_binary else values
        return unpacked.astype(np.float32)

    def samples(self, n_samples: int, seed: int) -> NDArray[np.float32]:
        """Return at most ``n_samples`` descriptors (n, D), drawn uniformly from all."""
        chosen = np.arange(len(self))
        if len(self) > n_samples:
            chosen = np.sort(np.random.default_rng(seed).choice(len(self), n_samples, False))
        starts = np.cumsum([0, *map(len, self.values)])
        parts = np.split(chosen, np.searchsorted(chosen, starts[1:-1]))
        return np.concatenate(
            [
                self.as_float(values[part - start])
                for values, part, start in zip(self.values, parts, starts[:-1], strict=True)
            ]
        )


def learn_vocabulary(
    run: DescriptorRun, name: str, *, n_words: int, seed: int
) -> tuple[tuple[Vocabulary, TfIdf], NDArray[np.int64]]:
    """Learn words and idf of the descriptors of a method called ``name``.

    Returns
    -------
    vocabulary : tuple
        The vocabulary and the weights of its words.
    counts : NDArray
        (N, n_words) number of times that each word occurs in each frame.

    Raises
    ------
    DatasetError
        If there are fewer descriptors than words.
    """
    if len(run) < n_words:
        raise DatasetError(f"found {len(run)} descriptors of {name}, expected at least {n_words}")
    vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(run.samples(MAX_SAMPLES, seed))
    words = [vocabulary.lookup(run.as_float(values)) for values in run.values]
    counts = count_words(words, n_words)
    return (vocabulary, TfIdf().fit(counts)), counts


def choose_frames(datasets: Sequence[Dataset], n_frames: int | None = None) -> list[LabelledFrame]:
    """Return all frames of the sequences, or ``n_frames`` of each, evenly spaced.

    Several sequences are a class each; a single one is cut into segments of time.

    Raises
    ------
    DatasetError
        If a sequence has too few frames for two of each class.
    """
    frames = []
    least = 4 if len(datasets) == 1 else 2
    names = [dataset.sequence for dataset in datasets]
    if len(set(names)) < len(names):
        names = [f"{number} {name}" for number, name in enumerate(names, start=1)]
    for dataset, label in zip(datasets, names, strict=True):
        n = min(n_frames or len(dataset), len(dataset))
        if n < least:
            raise DatasetError(
                f"{dataset.sequence}: found {n} frames, expected at least {least} to classify"
            )
        n_segments = min(N_SEGMENTS, n // 2)
        for k, index in enumerate(np.linspace(0, len(dataset) - 1, n).round().astype(int)):
            if len(datasets) == 1:
                label = f"segment {k * n_segments // n + 1}"
            frames.append(LabelledFrame(dataset, int(index), label))
    return frames


def describe(
    frames: Sequence[LabelledFrame], methods: Sequence[Method], on_progress: Progress
) -> tuple[Cost, dict[str, DescriptorRun]]:
    """Describe frames by all methods; return the cost of reading them, and a run by method."""
    runs = {
        m.name: DescriptorRun(registry.build("descriptors", m.plugin, m.options)) for m in methods
    }
    gray = any(run.descriptor.needs_gray for run in runs.values())
    middle = frames[len(frames) // 2].read(gray=gray)
    for run in runs.values():
        run.descriptor.describe(*middle)  # warm up: the first call costs more
        for _ in range(N_REPEATS):
            with run.one_frame.measure():
                run.descriptor.describe(*middle)
    reading = Cost()
    for start in range(0, len(frames), BLOCK_SIZE):
        images = []
        for frame in frames[start : start + BLOCK_SIZE]:
            with reading.measure():
                images.append(frame.read(gray=gray))
        for run in runs.values():
            for pair in images:
                with run.all_frames.measure():
                    values = run.descriptor.describe(*pair)
                run.keep(values)
        on_progress("Frames", start + len(images), len(frames))
    return reading, runs
