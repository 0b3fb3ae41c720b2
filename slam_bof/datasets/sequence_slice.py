"""A stretch of a sequence, as a sequence of its own."""

from __future__ import annotations

import re
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import ConfigError
from slam_bof.ports import Dataset
from slam_bof.types import DepthFrame, Trajectory

__all__ = ["Excerpt"]


class Excerpt:
    """The frames of a data set from a first one on, up to but without a last one.

    Examples
    --------
    >>> second_half = Excerpt.parse(dataset, "500:1000")  # doctest: +SKIP
    """

    name: ClassVar[str] = "excerpt"

    def __init__(self, dataset: Dataset, first: int, last: int) -> None:
        self._dataset = dataset
        self._range = range(len(dataset))[first:last]
        vars(self)["name"] = dataset.name
        self.sequence = f"{dataset.sequence}[{self._range.start}:{self._range.stop}]"
        self.intrinsics = dataset.intrinsics

    @classmethod
    def parse(cls, dataset: Dataset, text: str) -> Self:
        """Return the stretch that ``A:B`` names, A the first frame and B the first after it.

        Either may be left out.

        Raises
        ------
        ConfigError
            If the text is something else, or there are no such frames.
        """
        match = re.fullmatch(r"(\d*):(\d*)", text.strip())
        if match is None:
            raise ConfigError(f"--frames: found {text!r}, expected A:B, such as 400:1000")
        first, last = (int(number) if number else None for number in match.groups())
        excerpt = cls(dataset, first or 0, len(dataset) if last is None else last)
        if not len(excerpt):
            raise ConfigError(
                f"--frames: found none in {text!r}, expected some of the {len(dataset)} of "
                f"{dataset.sequence}"
            )
        return excerpt

    @property
    def frames(self) -> slice:
        """Which frames of the data set they are."""
        return slice(self._range.start, self._range.stop)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Say no: it is made of a data set, not found in a folder."""
        return False

    @classmethod
    def open(cls, path: Path) -> Self:
        """Refuse, as there is no such layout."""
        raise ConfigError(f"{path}: an excerpt is made of a data set, not opened")

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._range)

    def frame(self, index: int) -> DepthFrame:
        """Read a frame, counted from the first of the stretch."""
        return self._dataset.frame(self._range[index])

    def color(self, index: int) -> NDArray[np.uint8] | None:
        """Read its colour image, if there is one."""
        return self._dataset.color(self._range[index])

    def gray(self, index: int) -> NDArray[np.uint8] | None:
        """Read its grey image, if there is one."""
        return self._dataset.gray(self._range[index])

    def groundtruth(self) -> Trajectory | None:
        """Return the true poses of the stretch, if there are any."""
        truth = self._dataset.groundtruth()
        if truth is None:
            return None
        return Trajectory(truth.stamps_s[self.frames], truth.poses[self.frames])

    def scenes(self) -> tuple[str, ...] | None:
        """Return the true labels of the stretch, if there are any."""
        scenes = self._dataset.scenes()
        return None if scenes is None else scenes[self.frames]
