"""Compare methods that label scenes, on training and test frames chosen by a protocol."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import joblib
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
from slam_bof.evaluation.scene_methods import DescriptorMethod, ModelMethod, make_methods
from slam_bof.evaluation.scene_metrics import SceneScores, scene_scores
from slam_bof.evaluation.scene_splits import Split
from slam_bof.scenes import SvmParams, TrainingFrame, frame_groups
from slam_bof.synthetic import ROOM_KINDS, RoomViews, make_gallery
from slam_bof.types import Array

__all__ = [
    "SceneResult",
    "compare_methods",
    "compare_named_methods",
    "each_by_itself",
    "split_officially",
    "split_rooms",
    "split_sunrgbd",
]

TRAIN_SEED, TEST_SEED = 3000, 7000
"""Seeds of the first room to train with, and of the first one to test with."""
MAX_ROOMS = TEST_SEED - TRAIN_SEED

Progress = Callable[[str, int, int], None]
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True, eq=False)
class SceneResult:
    """The result of a method on the test frames.

    ``probabilities`` (N, C) are in the order of ``scores.classes``, ``true`` (N,) are the true
    labels. ``label_ms`` is the median CPU time from image to label in milliseconds, ``train_s``
    the CPU time of training in seconds, and ``n_bytes`` the size of what was learnt; None where
    not measured. ``svm_params`` is what a grid search chose.
    """

    method: str
    scores: SceneScores
    probabilities: Array
    true: tuple[str, ...]
    label_ms: float | None = None
    train_s: float | None = None
    n_bytes: int | None = None
    svm_params: SvmParams | None = None


def compare_methods(
    split: Split,
    methods: Sequence[ModelMethod | DescriptorMethod],
    *,
    groups: Sequence[str] | None = None,
    on_progress: Progress = lambda what, done, total: None,
) -> tuple[list[SceneResult], dict[str, str]]:
    """Train every method with the same frames and test it with the same other frames.

    Each frame is read once. Everything runs on one thread, so that times are comparable.

    Parameters
    ----------
    split
        The training and test frames.
    methods
        The methods, not fitted yet.
    groups
        The group of each training frame, which no calibration fold splits; by default its
        sequence, or a segment of it (``slam_bof.scenes.frame_groups``).
    on_progress
        Called with the name of the current task, the number of steps done, and their total.

    Returns
    -------
    results : list of SceneResult
        The results in the order of the methods.
    left_out : dict
        The reason for each method, by name, that could not be evaluated.

    Raises
    ------
    DatasetError
        If there are fewer than two classes, or no frames to test with.
    """
    split.check()
    left_out: dict[str, str] = {}
    needs_gray = any(method.needs_gray for method in methods)
    without_gray = _sequences_without_gray(split) if needs_gray else []
    evaluated = []
    for method in methods:
        if method.needs_gray and without_gray:
            left_out[method.name] = f"no colour images in {', '.join(without_gray)}"
        else:
            evaluated.append(method)
    sequences = sequence_names(split.train) if groups is None else groups
    groups = frame_groups(split.train) if groups is None else groups
    with one_thread():
        frames = _read_training(split.train, sequences, evaluated, on_progress)
        fitted = _fit(frames, split.train, groups, evaluated, left_out, on_progress)
        return _test(split, fitted, on_progress), left_out


def compare_named_methods(
    split: Split,
    names: Sequence[str],
    *,
    n_words: int = 1024,
    seed: int = 0,
    groups: Sequence[str] | None = None,
    n_jobs: int | None = 1,
    on_progress: Progress = lambda what, done, total: None,
) -> tuple[list[SceneResult], dict[str, str]]:
    """Make methods by name (``make_methods``) and compare them, several at a time if asked for.

    Parameters and results are those of ``compare_methods``, and ``n_jobs`` is the number of methods
    evaluated at a time, each in a process of its own that reads the frames again; None for that of
    the cluster of ``core.on_cluster``. But for times, the results do not depend on it.
    """
    methods = make_methods(names, n_words=n_words, seed=seed)
    if n_jobs == 1:
        return compare_methods(split, methods, groups=groups, on_progress=on_progress)
    alone = partial(compare_named_methods, split, n_words=n_words, seed=seed, groups=groups)
    results: list[SceneResult] = []
    left_out: dict[str, str] = {}
    for of_method, without in each_by_itself(alone, names, n_jobs, on_progress):
        results += of_method
        left_out |= without
    return results, left_out


def each_by_itself(
    evaluate: Callable[[list[str]], Result],
    names: Sequence[str],
    n_jobs: int | None,
    on_progress: Progress,
) -> Iterator[Result]:
    """Yield the result of each method, several of which are evaluated at a time by joblib."""
    jobs = [joblib.delayed(evaluate)([name]) for name in names]
    found = joblib.Parallel(n_jobs=n_jobs, return_as="generator")(jobs)
    for done, result in enumerate(found, start=1):
        yield result
        on_progress("Methods", done, len(names))


def split_officially(labels: Sequence[tuple[str, Path]], *, every: int = 1) -> Split:
    """Split sequences by the ``TrainSplit.txt`` and ``TestSplit.txt`` of each class's scene.

    Parameters
    ----------
    labels
        The name of each class and the folder of its scene, which has seq-XX folders and both
        files.
    every
        Take every n-th frame.
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
    """Split the images of SUN RGB-D as its authors do, and take every n-th of either side.

    Raises
    ------
    DatasetError
        If the data set has no labels, or no official split.
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

    Their seeds differ from each other and from those of the default model's rooms.
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


def _sequences_without_gray(split: Split) -> list[str]:
    datasets = {id(f.dataset): f.dataset for f in [*split.train, *split.test]}
    # Synthetic rooms always have grey images, and reading one would render the room.
    recorded = [d for d in datasets.values() if not isinstance(d, RoomViews)]
    return [d.sequence for d in recorded if d.gray(0) is None]


def _read_training(
    frames: Sequence[LabelledFrame],
    groups: Sequence[str],
    methods: Sequence[ModelMethod | DescriptorMethod],
    on_progress: Progress,
) -> Iterator[TrainingFrame]:
    """Yield the training frames, and add each to the methods by descriptors."""
    describing = [method for method in methods if isinstance(method, DescriptorMethod)]
    gray = any(method.needs_gray for method in describing)
    for done, (item, group) in enumerate(zip(frames, groups, strict=True), start=1):
        frame, image = item.read(gray=gray)
        for method in describing:
            method.add(frame, image)
        on_progress("Describing", done, len(frames))
        yield TrainingFrame(frame, item.label, group)


def _fit(
    frames: Iterator[TrainingFrame],
    labelled: Sequence[LabelledFrame],
    groups: Sequence[str],
    methods: Sequence[ModelMethod | DescriptorMethod],
    left_out: dict[str, str],
    on_progress: Progress,
) -> list[ModelMethod | DescriptorMethod]:
    """Fit the methods to the frames; return those that can be fitted, in the same order."""
    labels = [frame.label for frame in labelled]
    fitted: list[ModelMethod | DescriptorMethod] = []
    # Models read the frames. Methods by descriptors get them in passing (``_read_training``),
    # so they are fitted after all frames have been read.
    ordered = sorted(methods, key=lambda method: isinstance(method, DescriptorMethod))
    for done, method in enumerate(ordered, start=1):
        try:
            if isinstance(method, ModelMethod):
                method.fit(frames)
            else:
                deque(frames, maxlen=0)
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
            method=method.name,
            scores=scene_scores(probabilities[method.name], true, classes),
            probabilities=probabilities[method.name],
            true=true,
            label_ms=method.label.median_ms,
            train_s=method.train.cpu_s,
            n_bytes=method.nbytes(),
            svm_params=method.svm_params if isinstance(method, DescriptorMethod) else None,
        )
        for method in methods
    ]
