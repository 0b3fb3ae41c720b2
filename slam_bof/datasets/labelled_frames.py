"""Frames with a scene label each, read one by one from their data sets."""

from __future__ import annotations

import csv
import io
import os
import re
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import read_text, registry
from slam_bof.datasets.depth_images import CAMERA_FILE, DepthImages, is_image
from slam_bof.errors import DatasetError, PluginError
from slam_bof.ports import Dataset
from slam_bof.types import DepthFrame

__all__ = [
    "LabelledFrame",
    "LabelledSequence",
    "frames_of",
    "open_labelled",
    "open_sequences",
    "parse_label",
    "read_label_file",
    "read_split",
    "sequence_names",
]


@dataclass(frozen=True, slots=True)
class LabelledFrame:
    """A frame of a data set with its scene label.

    ``group`` names the room of a single image, where it is known: images of one group are never
    on both sides of a split. ``gravity_camera`` is the direction of gravity in the camera frame.
    """

    dataset: Dataset
    index: int
    label: str
    group: str | None = None
    gravity_camera: tuple[float, float, float] | None = None

    def read(self, *, gray: bool) -> tuple[DepthFrame, NDArray[np.uint8] | None]:
        """Read the depth image, and the grey image where ``gray``."""
        frame = self.dataset.frame(self.index)
        image = self.dataset.gray(self.index) if gray else None
        if gray and image is None:
            raise DatasetError(
                f"{self.dataset.sequence}: frame {self.index} has no colour image, "
                "expected one for every frame, or for none"
            )
        return frame, image


@dataclass(frozen=True, slots=True, eq=False)
class LabelledSequence:
    """A data set and its label; None where the data set has a label for every frame."""

    dataset: Dataset
    label: str | None


def parse_label(text: str) -> tuple[str, Path]:
    """Split NAME=PATH.

    >>> parse_label("kitchen=some/seq-01")
    ('kitchen', PosixPath('some/seq-01'))
    """
    name, sign, path = text.partition("=")
    if not (name.strip() and sign and path.strip()):
        raise DatasetError(f"found label {text!r}, expected NAME=PATH, such as kitchen=seq-01")
    return name.strip(), Path(path.strip()).expanduser()


def open_labelled(label: str | None, path: Path) -> list[LabelledSequence]:
    """Open sequences as ``open_sequences`` does, all with one label.

    Without ``label``, the data set must have labels of its frames.

    Raises
    ------
    DatasetError
        If there are none, or they have no labels and none was given.
    """
    sequences = [LabelledSequence(dataset, label) for dataset in open_sequences(path)]
    for sequence in sequences:
        if label is None and sequence.dataset.scenes() is None:
            raise DatasetError(f"{path}: found no scene labels there, expected NAME=PATH")
    return sequences


def open_sequences(path: Path) -> list[Dataset]:
    """Open a sequence, or all sequences of a folder that holds several, or one depth image.

    Raises
    ------
    DatasetError
        If the path is none of these, or a sequence has no frames.
    """
    if path.is_file() and is_image(path):
        return [DepthImages([path])]
    folders = [path]
    if path.is_dir():
        below = sorted(folder for folder in path.glob("seq-*") if folder.is_dir())
        folders = below if len(below) > 1 else folders
    if path.is_dir() and not (path / CAMERA_FILE).exists() and _is_plain(path):
        raise DatasetError(
            f"{path}: found images but no {CAMERA_FILE} beside them, expected one with "
            "width, height, fx, fy, cx, cy (px) and depth_scale (units a metre, such as 1000)"
        )
    datasets = [registry.open_dataset(folder) for folder in folders]
    if not all(map(len, datasets)):
        raise DatasetError(f"{path}: found no frames, expected some")
    return datasets


def _is_plain(folder: Path) -> bool:
    """Return whether a folder holds images that no data-set plug-in recognises."""
    entries = list(folder.iterdir())
    images = [entry for entry in entries if entry.is_file() and is_image(entry)]
    if not images or any(entry.is_dir() for entry in entries):
        return False
    for name in registry.names("datasets"):
        # A plug-in whose library is missing cannot be asked.
        with suppress(PluginError):
            if registry.load("datasets", name).recognises(folder):
                return False
    return True


def read_label_file(file: Path) -> list[LabelledSequence]:
    """Open the sequences and images that the rows ``path,label`` of a CSV file name.

    Paths are relative to the file. Depth images of one folder and label are one sequence, in the
    order of their rows.

    Raises
    ------
    DatasetError
        If the file cannot be read, or a path does not exist.
    """
    try:
        lines = io.StringIO(read_text(file), newline="")
        rows = [(number, row) for number, row in enumerate(csv.reader(lines), 1) if any(row)]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"{file}: found {reason}, expected CSV with path,label") from error
    if rows and [word.strip().lower() for word in rows[0][1]] == ["path", "label"]:
        rows = rows[1:]
    images: dict[tuple[str, Path], list[Path]] = {}
    sequences: list[LabelledSequence] = []
    for number, row in rows:
        words = [word.strip() for word in row]
        if len(words) != 2 or not all(words):
            raise DatasetError(
                f"{file}:{number}: found {','.join(row)[:80]!r}, expected path,label"
            )
        path, label = file.parent / Path(words[0]).expanduser(), words[1]
        if not os.path.exists(path):  # of names that no file can have, too
            found = f"no {words[0][:200]!r}"
            raise DatasetError(f"{file}:{number}: found {found}, expected a sequence or image")
        if path.is_file() and is_image(path):
            images.setdefault((label, path.parent), []).append(path)
        else:
            sequences += open_labelled(label, path)
    of_images = [LabelledSequence(DepthImages(paths), name) for (name, _), paths in images.items()]
    if not sequences and not of_images:
        raise DatasetError(f"{file}: found no rows, expected path,label")
    return sequences + of_images


def frames_of(sequences: Iterable[LabelledSequence], *, every: int = 1) -> list[LabelledFrame]:
    """List every n-th frame of sequences; frames without a label ("") are left out."""
    frames = []
    for sequence in sequences:
        dataset, labels = sequence.dataset, sequence.dataset.scenes()
        for index in range(0, len(dataset), every):
            label = sequence.label
            if label is None:
                label = labels[index] if labels is not None else ""
            if label:
                frames.append(LabelledFrame(dataset, index, label))
    return frames


def sequence_names(frames: Sequence[LabelledFrame]) -> list[str]:
    """Return a unique name of the group of each frame, or of its sequence where it has none."""
    numbers: dict[int, int] = {}
    return [
        f"group {frame.group}"
        if frame.group is not None
        else f"{numbers.setdefault(id(frame.dataset), len(numbers))} {frame.dataset.sequence}"
        for frame in frames
    ]


def read_split(scene: Path, name: str) -> list[Path]:
    """Return the sequences of a scene in 7-Scenes layout that a split file names.

    ``TrainSplit.txt`` or ``TestSplit.txt`` has lines such as ``sequence1``, which is ``seq-01``;
    sequences that are not there are left out.

    Raises
    ------
    DatasetError
        If there is no such file, it names no sequence, or none of those that it names exists.
    """
    file = scene / name
    try:
        words = read_text(file, "replace").split()
    except OSError:
        raise DatasetError(
            f"{file}: found no such file, expected lines such as sequence1"
        ) from None
    numbers = [int(match[1]) for word in words if (match := re.fullmatch(r"\D*(\d{1,9})", word))]
    if not numbers:
        raise DatasetError(f"{file}: found no sequences, expected lines such as sequence1")
    found = [
        folder
        for number in dict.fromkeys(numbers)
        for folder in (scene / f"seq-{number:02d}", scene / f"seq-{number}")
        if folder.is_dir()
    ]
    if not found:
        listed = ", ".join(f"seq-{number:02d}" for number in numbers)
        raise DatasetError(f"{scene}: found none of {listed}, which {name} names")
    return found
