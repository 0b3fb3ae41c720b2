"""Single labelled depth images with the room (group) that each shows, listed in a CSV file."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from slam_bof.core import read_text
from slam_bof.datasets.depth_images import DepthImages
from slam_bof.datasets.labelled_frames import LabelledFrame
from slam_bof.errors import DatasetError

__all__ = ["has_groups", "read_image_table"]

FILE_COLUMNS = ("file", "path")
SCENE_COLUMNS = ("scene", "scene_type", "label")
GROUP_COLUMN = "group"
ROTATION_COLUMNS = tuple(f"R{i}{j}" for i in range(3) for j in range(3))
EXPECTED = "columns file, scene, group and, if known, R00 to R22"


def has_groups(file: Path) -> bool:
    """Return whether a CSV file has a column of groups, so that ``read_image_table`` reads it."""
    try:
        lines = io.StringIO(read_text(file), newline="")
        return GROUP_COLUMN in [word.strip() for word in next(csv.reader(lines), [])]
    except (OSError, UnicodeDecodeError, csv.Error):
        return False


def read_image_table(file: Path, *, camera_file: Path | None = None) -> list[LabelledFrame]:
    """Read the labelled images that a CSV file lists.

    Parameters
    ----------
    file
        CSV with a header: ``file`` (relative to the CSV file), ``scene`` and ``group``; columns
        ``path``, ``scene_type`` and ``label`` have these names too. ``R00`` to ``R22``, if given,
        are the rotation from the camera to a level frame whose y axis points down.
    camera_file
        The camera of all images; by default ``intrinsics.json`` beside each.

    Raises
    ------
    DatasetError
        If the file cannot be read, a column or image is missing, or a row is wrong.
    """
    try:
        lines = io.StringIO(read_text(file), newline="")
        reader = csv.DictReader(lines, skipinitialspace=True)
        columns = list(reader.fieldnames or [])
        rows = [(reader.line_num, row) for row in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise DatasetError(f"{file}: found {reason}, expected CSV with {EXPECTED}") from error
    file_column, scene_column = (
        next((name for name in names if name in columns), None)
        for names in (FILE_COLUMNS, SCENE_COLUMNS)
    )
    if file_column is None or scene_column is None or GROUP_COLUMN not in columns:
        found = ", ".join(columns)[:200] or "nothing"
        raise DatasetError(f"{file}: found columns {found!r}, expected {EXPECTED}")
    has_gravity = set(ROTATION_COLUMNS) <= set(columns)
    items = []
    for number, row in rows:
        words = [(row[name] or "").strip() for name in (file_column, scene_column, GROUP_COLUMN)]
        path = file.parent / words[0]
        if not all(words):
            raise DatasetError(
                f"{file}:{number}: found {','.join(words)[:80]!r}, expected {EXPECTED}"
            )
        if not os.path.isfile(path):  # of names that no file can have, too
            found = f"no {words[0][:200]!r}"
            raise DatasetError(f"{file}:{number}: found {found}, expected a depth image")
        gravity = _gravity(row, f"{file}:{number}") if has_gravity else None
        items.append((path, words[1], words[2], gravity))
    if not items:
        raise DatasetError(f"{file}: found no rows, expected {EXPECTED}")
    # One data set for all: names of groups are those of the table.
    dataset = DepthImages([path for path, *_ in items], camera_file)
    return [
        LabelledFrame(dataset, index, scene, group, gravity)
        for index, (_, scene, group, gravity) in enumerate(items)
    ]


def _gravity(row: Mapping[str, str], where: str) -> tuple[float, float, float]:
    """Return the direction of gravity in the camera frame: the rotation's second row."""
    try:
        R = np.array([float(row[name]) for name in ROTATION_COLUMNS]).reshape(3, 3)
        if not np.allclose(R @ R.T, np.eye(3), atol=1e-3):
            raise ValueError("not orthonormal")
    except (TypeError, ValueError) as error:
        raise DatasetError(
            f"{where}: found R00 to R22 that are no rotation ({error}), expected one"
        ) from error
    x, y, z = R[1].tolist()
    return x, y, z
