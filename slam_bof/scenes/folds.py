"""Folds for cross-validation: groups of frames that must not be split."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.model_selection import StratifiedGroupKFold

from slam_bof.datasets import LabelledFrame, sequence_names

__all__ = ["cut_stretches", "grouped_folds", "moments"]

N_BLOCKS = 5
"""Stretches that a sequence is cut into, where its class has too few sequences to tell apart."""


def moments(frames: Sequence[LabelledFrame]) -> list[str]:
    """Name, for each frame, what shows the same as its neighbours: never to be split.

    That is its sequence, cut as ``cut_stretches`` does it.
    """
    return cut_stretches([frame.label for frame in frames], sequence_names(frames))


def cut_stretches(labels: Sequence[str], sequences: Sequence[str]) -> list[str]:
    """Cut sequences into stretches in time, where a class has too few to tell apart.

    Parameters
    ----------
    labels, sequences
        (N,) the class of each frame and the sequence that it is of, in the order of time.

    Returns
    -------
    list of str
        (N,) the sequence, where its class has at least ``N_BLOCKS`` of them; else one of so many
        stretches of its class there.

    Examples
    --------
    >>> cut_stretches(["hall"] * 10, ["a"] * 10)[::2]
    ['a hall 0', 'a hall 1', 'a hall 2', 'a hall 3', 'a hall 4']
    """
    of_class: dict[str, set[str]] = {}
    for label, name in zip(labels, sequences, strict=True):
        of_class.setdefault(label, set()).add(name)
    stretches = [f"{name} {label}" for label, name in zip(labels, sequences, strict=True)]
    lengths, seen = Counter(stretches), Counter[str]()
    found = []
    for label, name, stretch in zip(labels, sequences, stretches, strict=True):
        block = N_BLOCKS * seen[stretch] // lengths[stretch]
        seen[stretch] += 1
        many = len(of_class[label]) >= N_BLOCKS
        found.append(name if many else f"{stretch} {block}")
    return found


N_FOLDS = 5


def grouped_folds(y: NDArray[Any], groups: NDArray[Any], seed: int) -> Any:
    """Return (train, test) indices of folds that hold different moments, as far as can be."""
    smallest = min(len(np.unique(groups[y == label])) for label in np.unique(y))
    if smallest < 2:
        groups = np.arange(len(y))
        smallest = int(np.unique(y, return_counts=True)[1].min())
    n_folds = min(N_FOLDS, smallest)
    return StratifiedGroupKFold(n_folds, shuffle=True, random_state=seed).split(y, y, groups)
