"""What commands read: sequences, maps and model files, opened by what the user has typed."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from slam_bof.cli.one_line import one_line
from slam_bof.cli.options import parse_numbers

if TYPE_CHECKING:
    from slam_bof.ports import Dataset
    from slam_bof.slam import PluginChoice
    from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["map_file", "open_sequence", "read_image"]


def map_file(path: Path) -> Path:
    """Return the map.db in the folder of a run, or the path itself if it is no folder."""
    return path / "map.db" if path.is_dir() else path


def open_sequence(
    path: Path, choice: PluginChoice, frames: str | None, *, quiet: bool
) -> tuple[Dataset, list[str]]:
    """Open a sequence; return it, and remarks: how its layout was recognised, and warnings.

    Raises
    ------
    DatasetError
        If the layout is unknown, or the folder has single images instead of a sequence.
    """
    from slam_bof.core import registry
    from slam_bof.datasets import SequenceSlice
    from slam_bof.errors import DatasetError
    from slam_bof.ports import LabelledImages

    name, remarks = choice.name, []
    if name == "auto":
        found = registry.recognise_dataset(path)
        name, remarks = found.name, [f"{path}: {found}"]
        if not quiet:
            typer.echo(one_line(remarks[0]), err=True)
    with _collecting_warnings() as warnings:
        dataset = registry.open_dataset(path, name, choice.options)
    remarks += warnings
    if isinstance(dataset, LabelledImages):
        raise DatasetError(
            f"{path}: found single images of {name}, expected a sequence; "
            "single images serve train and evaluate scenes"
        )
    return (dataset if frames is None else SequenceSlice.parse(dataset, frames)), remarks


def read_image(
    path: Path, map_: Path | None, *, intrinsics: str | None, depth_scale: float | None
) -> tuple[DepthFrame, str]:
    """Read a depth image whose camera and unit are given, in intrinsics.json, or those of a map.

    Return the frame, and the source of its intrinsics in words. What is implausible about its
    camera or its unit of depth is printed as a warning.

    Raises
    ------
    DatasetError
        If they are unknown: they are not guessed.
    """
    from slam_bof.datasets import CAMERA_FILE, doubts_of_image, read_depth_image
    from slam_bof.errors import DatasetError
    from slam_bof.store import MapStore

    if not os.path.isfile(path):  # is_file raises for long names
        raise DatasetError(f"{str(path)[-200:]}: found no such file, expected a depth image")
    given: Intrinsics | list[float] | None = None
    if intrinsics is not None:
        given = parse_numbers("--intrinsics", intrinsics, "FX FY CX CY in pixels")
    is_described = (path.parent / CAMERA_FILE).is_file()
    source = ""
    if map_ is not None:
        with MapStore.open(map_) as store:
            camera, units = store.intrinsics(), store.parameters().get("units_per_m", "null")
    if map_ is not None and not (is_described and given is None):
        if given is None and camera is not None:
            given, source = camera, f"from {store.path}"
        if depth_scale is None and path.suffix != ".npy":
            depth_scale = json.loads(units)
            if depth_scale is None:
                raise DatasetError(
                    f"{path}: found no unit of depth in {store.path}, expected --depth-scale, the "
                    "units per metre, such as 1000"
                )
    if given is None and not is_described:
        raise DatasetError(
            f"{path}: found no {CAMERA_FILE} beside it, expected --intrinsics FX FY CX CY, or "
            "--map for the camera of a map"
        )
    if depth_scale is None and map_ is None and not is_described and path.suffix != ".npy":
        raise DatasetError(
            f"{path}: found no {CAMERA_FILE} beside it, expected --depth-scale, the units of depth "
            "per metre, such as 1000"
        )
    frame, found = read_depth_image(path, intrinsics=given, depth_scale=depth_scale)
    for doubt in doubts_of_image(frame):
        typer.echo(one_line(f"warning: {path}: {doubt}"), err=True)
    return frame, source or found


class _Collector(logging.Handler):
    """Keeps messages."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message."""
        self.messages.append(f"{record.levelname}: {record.getMessage()}")


@contextmanager
def _collecting_warnings() -> Iterator[list[str]]:
    """Collect what is warned of, for the log of a run that does not exist yet."""
    collector, root = _Collector(), logging.getLogger()
    root.addHandler(collector)
    try:
        yield collector.messages
    finally:
        root.removeHandler(collector)
