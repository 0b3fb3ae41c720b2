"""What commands read: sequences, maps and model files, opened by what the user has typed."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from slam_bof.ports import Dataset
    from slam_bof.slam import PluginChoice

__all__ = ["map_file", "open_sequence"]


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
            typer.echo(remarks[0], err=True)
    with _collecting_warnings() as warnings:
        dataset = registry.open_dataset(path, name, choice.options)
    remarks += warnings
    if isinstance(dataset, LabelledImages):
        raise DatasetError(
            f"{path}: found single images of {name}, expected a sequence; "
            "single images serve train and evaluate scenes"
        )
    return (dataset if frames is None else SequenceSlice.parse(dataset, frames)), remarks


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
