"""Answers for one depth image, or for those of a sequence, each printed as a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import typer

from slam_bof.cli.options import Format
from slam_bof.cli.tables import show_rows

if TYPE_CHECKING:
    from slam_bof.ports import Dataset
    from slam_bof.types import DepthFrame, Pose

__all__ = ["pose_values", "show_answer", "show_answers"]

Answer = Callable[["DepthFrame"], dict[str, Any]]
"""Returns the answer for a frame: ``is_known``, ``reason`` and the rest of its row."""
Columns = Sequence[tuple[str, str]]


def show_answer(frame: DepthFrame, answer: Answer, columns: Columns, form: Format) -> None:
    """Print the answer for one image."""
    from slam_bof.cli.console import print_json

    row = {"frame_index": 0, **answer(frame)}
    if form == "json":
        print_json(row)
    else:
        show_rows([row], columns, form)


def show_answers(
    sequence: Dataset, answer: Answer, columns: Columns, form: Format, *, every: int, quiet: bool
) -> list[dict[str, Any]]:
    """Print and return the answer for every n-th frame of a sequence.

    A frame that cannot be read is unknown, for that reason.
    """
    from slam_bof.cli.console import Bar
    from slam_bof.datasets import first_frame
    from slam_bof.errors import DatasetError

    rows: list[dict[str, Any]] = []
    first = first_frame(sequence)
    with Bar("Localizing", quiet=quiet or form != "table") as bar:
        for index in range(0, len(sequence), every):
            try:
                frame = sequence.frame(index)
            except DatasetError as error:
                found: dict[str, Any] = {"is_known": False, "reason": str(error)}
            else:
                found = answer(frame)
            rows.append({"frame_index": first + index, **found})
            bar.show(index + 1, len(sequence))
    show_rows(rows, columns, form)
    if form == "table":
        n_known = sum(row["is_known"] for row in rows)
        typer.echo(f"{n_known} of {len(rows)} frames localized")
    return rows


def pose_values(T_map_camera: Pose | None) -> dict[str, Any]:
    """Return a pose as values of a row."""
    from slam_bof.geometry import se3

    T = T_map_camera
    return {
        "translation_m": None if T is None else tuple(T[:3, 3].tolist()),
        "quaternion_xyzw": None if T is None else tuple(se3.to_quaternion(T).tolist()),
        "T_map_camera": None if T is None else T.tolist(),
    }
