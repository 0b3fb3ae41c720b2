"""Folds for cross-validation: frames of one group never stand on both sides of a fold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from sklearn.model_selection import StratifiedGroupKFold, StratifiedKFold

from slam_bof.datasets import LabelledFrame, sequence_names

__all__ = ["cut_segments", "frame_groups", "make_folds"]

N_SEGMENTS = 5
"""Number of segments that a sequence is cut into where its class has fewer sequences than that."""

Fold = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Indices of the samples to train with, and of those to test with."""


def frame_groups(frames: Sequence[LabelledFrame]) -> list[str]:
    """Return the group of each frame: its own, its sequence, or a segment of it.

    Sequences are cut by ``cut_segments``; a frame with a group of its own stays in it.
    """
    names = sequence_names(frames)
    segments = cut_segments([frame.label for frame in frames], names)
    return [
        segment if frame.group is None else name
        for frame, name, segment in zip(frames, names, segments, strict=True)
    ]


def cut_segments(labels: Sequence[str], sequences: Sequence[str]) -> list[str]:
    """Group frames by sequence, and cut sequences into segments where a class has few of them.

    Neighbouring frames are similar, so a fold that splits them overestimates the accuracy.

    Parameters
    ----------
    labels, sequences
        (N,) the class of each frame and the name of its sequence, in the order of time.

    Returns
    -------
    list of str
        (N,) the group of each frame: the sequence where its class has at least ``N_SEGMENTS``
        sequences, else one of ``N_SEGMENTS`` equally long segments of the frames that this
        class has in that sequence.

    Examples
    --------
    >>> cut_segments(["hall"] * 10, ["a"] * 10)[::2]
    ['a hall 0', 'a hall 1', 'a hall 2', 'a hall 3', 'a hall 4']
    """
    sequences_of_class: dict[str, set[str]] = {}
    for label, sequence in zip(labels, sequences, strict=True):
        sequences_of_class.setdefault(label, set()).add(sequence)
    names = [f"{sequence} {label}" for label, sequence in zip(labels, sequences, strict=True)]
    n_frames, n_before = Counter(names), Counter[str]()
    groups = []
    for label, sequence, name in zip(labels, sequences, names, strict=True):
        segment = N_SEGMENTS * n_before[name] // n_frames[name]
        n_before[name] += 1
        has_enough = len(sequences_of_class[label]) >= N_SEGMENTS
        groups.append(sequence if has_enough else f"{name} {segment}")
    return groups


def make_folds(y: ArrayLike, groups: ArrayLike | None, n_folds: int, seed: int) -> list[Fold]:
    """Return stratified folds that split no group, or folds by sample where that is impossible.

    It is impossible where a class has a single group, or where every frame of a class would be in
    one test fold, so that training would not see the class.

    Parameters
    ----------
    y
        (N,) class of each sample.
    groups
        (N,) group of each sample; None where samples are independent.
    n_folds
        Number of folds; fewer where the smallest class has fewer groups (or samples).
    seed
        Seed of the shuffling.

    Examples
    --------
    >>> folds = make_folds([0, 0, 1, 1], ["a", "b", "c", "d"], n_folds=5, seed=0)
    >>> [sorted(np.concatenate(fold).tolist()) for fold in folds]
    [[0, 1, 2, 3], [0, 1, 2, 3]]
    """
    y = np.asarray(y)
    classes, counts = np.unique(y, return_counts=True)
    if groups is not None:
        groups = np.asarray(groups)
        n_grouped = min(n_folds, min(len(np.unique(groups[y == label])) for label in classes))
        if n_grouped >= 2:
            splitter: Any = StratifiedGroupKFold(n_grouped, shuffle=True, random_state=seed)
            folds = list(splitter.split(y, y, groups))
            if all(len(np.unique(y[train])) == len(classes) for train, _ in folds):
                return folds
    splitter = StratifiedKFold(min(n_folds, int(counts.min())), shuffle=True, random_state=seed)
    return list(splitter.split(y, y))
