"""Describe the same frames by several methods, in turns, and keep what they find."""

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

__all__ = ["METHODS", "Described", "Method", "Progress", "choose_frames", "describe", "learn_bags"]

BLOCK = 25
"""Frames that one method describes before it is the next one's turn."""
N_REPEATS = 10
"""How often process 1 describes one frame."""
MAX_SAMPLES = 150_000
"""Local features that ``learn_bags`` learns words of at most."""
N_STRETCHES = 5
"""Classes that a single sequence is cut into, where it has frames enough."""

Progress = Callable[[str, int, int], None]
"""Called with what is being done, how much of it is, and of how much."""


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


@dataclass(frozen=True, slots=True, eq=False)
class Described:
    """What a method found in all frames, and what that cost.

    ``values`` has the descriptors of each frame, as bytes where these hold them exactly: SIFT's
    are whole numbers, and a thousand frames of them would fill half a gigabyte as float32.
    """

    descriptor: Descriptor
    one: Cost = field(default_factory=Cost)
    all: Cost = field(default_factory=Cost)
    values: list[NDArray[Any]] = field(default_factory=list)

    def __len__(self) -> int:
        """Return the number of descriptors."""
        return sum(map(len, self.values))

    @property
    def nbytes(self) -> int:
        """Bytes of the descriptors as the method gives them: bits, or float32."""
        size = 1 if self.descriptor.is_binary else 4
        return sum(found.size for found in self.values) * size

    def keep(self, found: NDArray[Any]) -> None:
        """Keep a frame's descriptors."""
        whole = found.astype(np.uint8)
        self.values.append(whole if np.array_equal(whole, found) else found)

    def numbers(self, found: NDArray[Any]) -> NDArray[np.float32]:
        """Return descriptors as k-means takes them: (M, D) float32, a bit as 0 or 1."""
        values = np.unpackbits(found, axis=1) if self.descriptor.is_binary else found
        return values.astype(np.float32)

    def samples(self, n_samples: int, seed: int) -> NDArray[np.float32]:
        """Return at most so many descriptors (n, D), drawn evenly from all."""
        chosen = np.arange(len(self))
        if len(self) > n_samples:
            chosen = np.sort(np.random.default_rng(seed).choice(len(self), n_samples, False))
        starts = np.cumsum([0, *map(len, self.values)])
        parts = np.split(chosen, np.searchsorted(chosen, starts[1:-1]))
        return np.concatenate(
            [
                self.numbers(found[part - start])
                for found, part, start in zip(self.values, parts, starts[:-1], strict=True)
            ]
        )


def learn_bags(
    found: Described, name: str, *, n_words: int, seed: int
) -> tuple[tuple[Vocabulary, TfIdf], NDArray[np.int64]]:
    """Learn words and idf of what a method called ``name`` found in frames.

    Returns
    -------
    bags : tuple
        The vocabulary and the weights of its words.
    counts : NDArray
        (N, n_words) how often each frame has each word.

    Raises
    ------
    DatasetError
        If that is fewer descriptors than words.
    """
    if len(found) < n_words:
        raise DatasetError(f"found {len(found)} descriptors of {name}, expected at least {n_words}")
    vocabulary = Vocabulary(n_words=n_words, seed=seed).fit(found.samples(MAX_SAMPLES, seed))
    counts = count_words(
        [vocabulary.lookup(found.numbers(values)) for values in found.values], n_words
    )
    return (vocabulary, TfIdf().fit(counts)), counts


def choose_frames(datasets: Sequence[Dataset], n_frames: int | None = None) -> list[LabelledFrame]:
    """Return the frames of all sequences, or so many of each, evenly spaced.

    Several sequences are a class each; one is cut into stretches of time.

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
        n_stretches = min(N_STRETCHES, n // 2)
        for k, index in enumerate(np.linspace(0, len(dataset) - 1, n).round().astype(int)):
            if len(datasets) == 1:
                label = f"stretch {k * n_stretches // n + 1}"
            frames.append(LabelledFrame(dataset, int(index), label))
    return frames


def describe(
    frames: Sequence[LabelledFrame], methods: Sequence[Method], on_progress: Progress
) -> tuple[Cost, dict[str, Described]]:
    """Describe frames by all methods; return the cost of reading them, and what each found."""
    described = {
        m.name: Described(registry.build("descriptors", m.plugin, m.options)) for m in methods
    }
    gray = any(run.descriptor.needs_gray for run in described.values())
    middle = frames[len(frames) // 2].read(gray=gray)
    for run in described.values():
        run.descriptor.describe(*middle)  # what only a first call costs
        for _ in range(N_REPEATS):
            with run.one.measure():
                run.descriptor.describe(*middle)
    reading = Cost()
    for start in range(0, len(frames), BLOCK):
        images = []
        for frame in frames[start : start + BLOCK]:
            with reading.measure():
                images.append(frame.read(gray=gray))
        for run in described.values():
            for pair in images:
                with run.all.measure():
                    found = run.descriptor.describe(*pair)
                run.keep(found)
        on_progress("Frames", start + len(images), len(frames))
    return reading, described
