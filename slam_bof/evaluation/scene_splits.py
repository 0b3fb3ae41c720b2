"""Splits of frames into training and test frames.

The protocol ``holdout`` draws frames at random, so that almost every test frame has a training
frame next to it in time (the paper's Table 2). The protocol ``time-split`` trains on the beginning
of each sequence and tests on its end, with a gap between them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from slam_bof.datasets import LabelledFrame, sequence_names
from slam_bof.errors import DatasetError

__all__ = ["Split", "split_at_random", "split_by_group", "split_by_time"]

GAP_S = 2.0
GAP_SHARE = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Split:
    """Frames to train with, and frames to test with."""

    train: list[LabelledFrame]
    test: list[LabelledFrame]

    def check(self, *, min_classes: int = 2) -> None:
        """Raise ``DatasetError`` unless there are enough frames to train and to test with."""
        classes = {frame.label for frame in self.train}
        if len(classes) < min_classes:
            found, least = ", ".join(sorted(classes)) or "none", ("one", "two")[min_classes - 1]
            raise DatasetError(f"found classes to train with: {found}; expected at least {least}")
        few = [name for name in classes if sum(f.label == name for f in self.train) < 2]
        if few:
            raise DatasetError(f"found one frame of {', '.join(sorted(few))}, expected at least 2")
        if not any(frame.label in classes for frame in self.test):
            raise DatasetError("found no frames to test with, expected some of the same classes")


def split_at_random(
    frames: Sequence[LabelledFrame], *, test_share: float = 0.25, seed: int = 0
) -> Split:
    """Test with a random share of each sequence's frames."""
    rng = np.random.default_rng(seed)
    split = Split([], [])
    for of_sequence in _by_sequence(frames):
        n_test = round(test_share * len(of_sequence))
        tested = set(rng.permutation(len(of_sequence))[:n_test].tolist())
        for k, frame in enumerate(of_sequence):
            (split.test if k in tested else split.train).append(frame)
    return split


def split_by_group(
    frames: Sequence[LabelledFrame], *, test_share: float = 0.25, seed: int = 0
) -> Split:
    """Test with a random share of the groups of each class; a class of one group is not tested."""
    rng = np.random.default_rng(seed)
    groups = sequence_names(frames)
    tested: set[str] = set()
    for label in sorted({frame.label for frame in frames}):
        of_class = {g for g, frame in zip(groups, frames, strict=True) if frame.label == label}
        shuffled = rng.permutation(sorted(of_class)).tolist()
        n_test = min(max(1, round(test_share * len(shuffled))), len(shuffled) - 1)
        tested |= set(shuffled[:n_test])
    split = Split([], [])
    for group, frame in zip(groups, frames, strict=True):
        (split.test if group in tested else split.train).append(frame)
    return split


def split_by_time(
    frames: Sequence[LabelledFrame],
    *,
    train_share: float = 0.6,
    test_share: float = 0.4,
    gap_s: float = GAP_S,
    gap_share: float = GAP_SHARE,
) -> Split:
    """Train with the first share of each sequence, test with the last one.

    Test frames less than ``gap_s`` seconds after the last training frame are left out. Where that
    would leave less than half of them, the gap is ``gap_share`` of the sequence's duration.
    """
    split = Split([], [])
    for of_sequence in _by_sequence(frames):
        stamps_s = np.array([frame.dataset.frame(frame.index).stamp_s for frame in of_sequence])
        n = len(of_sequence)
        n_train = round(train_share * n)
        split.train.extend(of_sequence[:n_train])
        first = max(n_train, n - round(test_share * n))
        if n_train:
            start = int(np.searchsorted(stamps_s, stamps_s[n_train - 1] + gap_s))
            if n - start < (n - first) / 2:
                gap = gap_share * (stamps_s[-1] - stamps_s[0])
                start = int(np.searchsorted(stamps_s, stamps_s[n_train - 1] + gap))
            first = max(first, start)
        split.test.extend(of_sequence[first:])
    return split


def _by_sequence(frames: Sequence[LabelledFrame]) -> list[list[LabelledFrame]]:
    """Group frames by data set and, in a data set of several classes, by label."""
    groups: dict[tuple[int, str], list[LabelledFrame]] = {}
    for frame in frames:
        groups.setdefault((id(frame.dataset), frame.label), []).append(frame)
    return list(groups.values())
