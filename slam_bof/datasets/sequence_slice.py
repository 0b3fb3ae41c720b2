"""A slice of a sequence, as a sequence of its own."""

from __future__ import annotations

import re
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import ConfigError
from slam_bof.ports import Dataset, ScaledDataset
from slam_bof.types import DepthFrame, Trajectory

__all__ = ["SequenceSlice", "first_frame"]


def first_frame(dataset: Dataset) -> int:
    """Return the number, in the whole sequence, of the first frame: not 0 for a slice."""
    return dataset.frames.start if isinstance(dataset, SequenceSlice) else 0


class SequenceSlice:
    """Consecutive frames of a sequence, from ``first`` up to but not including ``last``.

    Examples
    --------
    >>> second_half = SequenceSlice.parse(dataset, "500:1000")  # doctest: +SKIP
    """

    def __init__(self, dataset: Dataset, first: int, last: int) -> None:
        self._dataset = dataset
        self._range = range(len(dataset))[first:last]
        self.name = dataset.name
        self.sequence = f"{dataset.sequence}[{self._range.start}:{self._range.stop}]"
        self.intrinsics = dataset.intrinsics
        if isinstance(dataset, ScaledDataset):
            self.units_per_m = dataset.units_per_m

    @classmethod
    def parse(cls, dataset: Dataset, text: str) -> Self:
        """Return the slice ``A:B``, from frame A up to but not including frame B.

        Either may be left out.

        Raises
        ------
        ConfigError
            If the text has another form, or there are no such frames.
        """
        match = re.fullmatch(r"([0-9]{0,18}):([0-9]{0,18})", text.strip())
        if match is None:
            raise ConfigError(f"--frames: found {text!r}, expected A:B, such as 400:1000")
        first, last = (int(number) if number else None for number in match.groups())
        part = cls(dataset, first or 0, len(dataset) if last is None else last)
        if not len(part):
            raise ConfigError(
                f"--frames: found none in {text!r}, expected some of the {len(dataset)} of "
                f"{dataset.sequence}"
            )
        return part

    @property
    def frames(self) -> slice:
        """The frames' indices in the whole sequence."""
        return slice(self._range.start, self._range.stop)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._range)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame, counted from the first of the slice."""
        return self._dataset.frame(self._range[index])

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read its colour image, if there is one."""
        return self._dataset.color(self._range[index])

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read its grey image, if there is one."""
        return self._dataset.gray(self._range[index])

    def groundtruth(self) -> Trajectory | None:
        """Return the true poses of the slice, if there are any."""
        truth = self._dataset.groundtruth()
        if truth is None:
            return None
        return Trajectory(truth.stamps_s[self.frames], truth.poses[self.frames])

    def scenes(self) -> tuple[str, ...] | None:
        """Return the true labels of the slice, if there are any."""
        scenes = self._dataset.scenes()
        return None if scenes is None else scenes[self.frames]
