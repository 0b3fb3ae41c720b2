"""Compare ways to label scenes, on frames that a protocol has split (``scene_splits``)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slam_bof.core import registry
from slam_bof.datasets import (
    LabelledFrame,
    LabelledSequence,
    frames_of,
    read_split,
    sequence_names,
)
from slam_bof.errors import DatasetError
from slam_bof.evaluation.cost import one_thread
from slam_bof.evaluation.scene_methods import DescriptorMethod, ModelMethod
from slam_bof.evaluation.scene_metrics import SceneScores, score
from slam_bof.evaluation.scene_splits import Split
from slam_bof.scenes import TrainingFrame, moments
from slam_bof.synthetic import ROOM_KINDS, RoomViews, make_gallery
from slam_bof.types import Array

__all__ = [
    "SceneResult",
    "compare",
    "split_officially",
    "split_rooms",
    "split_sunrgbd",
]

TRAIN_SEED, TEST_SEED = 3000, 7000
"""Of the first room to train with, and of the first one to test with."""
MAX_ROOMS = TEST_SEED - TRAIN_SEED

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """What a method came to on the test frames.

    ``probabilities`` (N, C) are by ``scores.classes``. ``label_ms`` is the CPU that a frame takes
    from image to label (median), ``train_s`` the CPU of training, and ``n_bytes`` the size of
    what was learnt.
    """

    method: str
    scores: SceneScores
    probabilities: Array
    true: tuple[str, ...]
    label_ms: float
    train_s: float
    n_bytes: int


def compare(
    split: Split,
    methods: Sequence[ModelMethod | DescriptorMethod],
    *,
    groups: Sequence[str] | None = None,
    on_progress: Progress = lambda what, done, total: None,
) -> tuple[list[SceneResult], dict[str, str]]:
    """Train every method with the same frames and test it with the same others.

    Each frame is read once. One thread does all, that methods' times can be compared.

    Parameters
    ----------
    split
        The frames.
    methods
        Not fitted yet.
    groups
        The moment that each training frame shows, which no fold of a calibration splits; by
        default its sequence, or a stretch of it (``labelled.moments``).
    on_progress
        Called with what is done, how much of it is, and of how much.

    Returns
    -------
    results : list of SceneResult
        In the order of the methods.
    left_out : dict
        By name, the methods that could not be judged, and why.

    Raises
    ------
    DatasetError
        If there are fewer than two classes, or no frames to test with.
    """
    split.check()
    left_out: dict[str, str] = {}
    dark = _dark(split) if any(method.needs_gray for method in methods) else []
    judged = []
    for method in methods:
        if method.needs_gray and dark:
            left_out[method.name] = f"no colour images in {', '.join(dark)}"
        else:
            judged.append(method)
    sequences = sequence_names(split.train) if groups is None else groups
    groups = moments(split.train) if groups is None else groups
    with one_thread():
        seen = _show(split.train, sequences, judged, on_progress)
        fitted = _fit(seen, split.train, groups, judged, left_out, on_progress)
        return _test(split, fitted, on_progress), left_out


def split_officially(labels: Sequence[tuple[str, Path]], *, every: int = 1) -> Split:
    """Split sequences by the ``TrainSplit.txt`` and ``TestSplit.txt`` of each class's scene.

    Parameters
    ----------
    labels
        A name and the folder of its scene, with seq-XX folders and both files, for each class.
    every
        Take each so many frames.
    """
    sides = []
    for name in ("TrainSplit.txt", "TestSplit.txt"):
        sequences = [
            LabelledSequence(registry.open_dataset(folder), label)
            for label, scene in labels
            for folder in read_split(scene, name)
        ]
        sides.append(frames_of(sequences, every=every))
    return Split(*sides)


def split_sunrgbd(path: Path, *, every: int = 1) -> Split:
    """Split the images of SUN RGB-D as its authors do.

    Raises
    ------
    DatasetError
        If the data set has no labels, or does not say which images are to train with.
    """
    dataset: Any = registry.open_dataset(path)
    is_train = getattr(dataset, "is_train", None)
    if is_train is None or dataset.scenes() is None:
        raise DatasetError(
            f"{path}: found {dataset.name}, expected a data set that says which images train"
        )
    split = Split([], [])
    for frame in frames_of([LabelledSequence(dataset, None)]):
        side = split.train if is_train[frame.index] else split.test
        side.append(frame)
    return Split(split.train[::every], split.test[::every])


def split_rooms(n_train_rooms: int, n_test_rooms: int, n_views: int, *, seed: int = 0) -> Split:
    """Make synthetic rooms of every kind to train with, and others to test with.

    Seeds of the two never meet, nor those of the model that comes along.
    """
    n_rooms = max(n_train_rooms, n_test_rooms)
    if (seed + 1) * n_rooms > MAX_ROOMS:
        raise DatasetError(
            f"found {n_rooms} rooms of seed {seed}, expected at most {MAX_ROOMS} in all"
        )
    sides = []
    for first, n in ((TRAIN_SEED, n_train_rooms), (TEST_SEED, n_test_rooms)):
        start = first + seed * n_rooms
        rooms = make_gallery(range(start, start + n), n_views, kinds=ROOM_KINDS)
        sides.append(frames_of([LabelledSequence(room, None) for room in rooms]))
    return Split(*sides)


def _dark(split: Split) -> list[str]:
    """Return the sequences without grey images."""
    datasets = {id(f.dataset): f.dataset for f in [*split.train, *split.test]}
    # To ask a synthetic room would be to make it.
    asked = [d for d in datasets.values() if not isinstance(d, RoomViews)]
    return [d.sequence for d in asked if d.gray(0) is None]


def _show(
    frames: Sequence[LabelledFrame],
    groups: Sequence[str],
    methods: Sequence[ModelMethod | DescriptorMethod],
    on_progress: Progress,
) -> Iterator[TrainingFrame]:
    """Yield the frames to train with; show each to those that describe them in passing."""
    describing = [method for method in methods if isinstance(method, DescriptorMethod)]
    gray = any(method.needs_gray for method in describing)
    for done, (item, group) in enumerate(zip(frames, groups, strict=True), start=1):
        frame, image = item.read(gray=gray)
        for method in describing:
            method.see(frame, image)
        on_progress("Describing", done, len(frames))
        yield TrainingFrame(frame, item.label, group)


def _fit(
    seen: Iterator[TrainingFrame],
    frames: Sequence[LabelledFrame],
    groups: Sequence[str],
    methods: Sequence[ModelMethod | DescriptorMethod],
    left_out: dict[str, str],
    on_progress: Progress,
) -> list[ModelMethod | DescriptorMethod]:
    labels = [frame.label for frame in frames]
    # What the model is trained with passes by the others, which are fitted when all has passed.
    fitted: list[ModelMethod | DescriptorMethod] = []
    ordered = sorted(methods, key=lambda method: isinstance(method, DescriptorMethod))
    for done, method in enumerate(ordered, start=1):
        try:
            if isinstance(method, ModelMethod):
                method.fit(seen)
            else:
                deque(seen, maxlen=0)
                method.fit(labels, groups)
            fitted.append(method)
        except DatasetError as error:
            left_out[method.name] = str(error)
        on_progress("Training", done, len(methods))
    return [method for method in methods if method in fitted]


def _test(
    split: Split, methods: Sequence[ModelMethod | DescriptorMethod], on_progress: Progress
) -> list[SceneResult]:
    known = sorted({frame.label for frame in split.train})
    classes = sorted({*known, *(frame.label for frame in split.test)})
    columns = [classes.index(name) for name in known]
    true = tuple(frame.label for frame in split.test)
    probabilities = {m.name: np.zeros((len(true), len(classes))) for m in methods}
    gray = any(method.needs_gray for method in methods)
    for row, item in enumerate(split.test):
        frame, image = item.read(gray=gray)
        for method in methods:
            probabilities[method.name][row, columns] = method.probabilities(frame, image)
        on_progress("Testing", row + 1, len(true))
    return [
        SceneResult(
            method.name,
            score(probabilities[method.name], true, classes),
            probabilities[method.name],
            true,
            method.label.median_ms,
            method.train.cpu_s,
            method.nbytes(),
        )
        for method in methods
    ]
