"""What the measuring scripts share: options, tables, progress, and errors in one line.

A script describes itself in its docstring, makes its parser by ``make_parser``, and gives ``run`` a
function that measures. Its figures go to a ``Table``, which prints them as text, as a Markdown
table (``--markdown``) or as one JSON object a line (``--json``).
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from slam_bof.core import registry
from slam_bof.datasets import SequenceSlice
from slam_bof.errors import DatasetError, SlamBofError
from slam_bof.ports import Dataset
from slam_bof.slam import Config, config as configs
from slam_bof.types import Array

MIN_CELL = 8
"""Least width of a column of text."""


def make_parser(doc: str | None) -> argparse.ArgumentParser:
    """Return a parser whose help is a script's docstring; every script can print its figures."""
    summary, _, rest = (doc or "").partition("\n")
    parser = argparse.ArgumentParser(
        description=summary,
        epilog=rest.strip() or None,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    form = parser.add_mutually_exclusive_group()
    form.add_argument("--json", action="store_true", help="print one JSON object a line")
    form.add_argument("--markdown", action="store_true", help="print Markdown tables")
    return parser


def add_sequence(parser: argparse.ArgumentParser) -> None:
    """Add the sequence to measure on, read by ``open_sequence(arguments.sequence, arguments)``."""
    parser.add_argument("sequence", type=Path, metavar="SEQUENCE")
    add_max_frames(parser)


def add_sequences(parser: argparse.ArgumentParser) -> None:
    """Add one or more sequences to measure on."""
    parser.add_argument("sequences", nargs="+", type=Path, metavar="SEQUENCE")
    add_max_frames(parser)


def add_max_frames(parser: argparse.ArgumentParser) -> None:
    """Add the number of frames that are read of each sequence."""
    parser.add_argument(
        "--max-frames", type=int, metavar="N", help="first frames of each sequence (default: all)"
    )


def add_config(parser: argparse.ArgumentParser, default: str = "indoor") -> None:
    """Add the configuration, read by ``load_config``."""
    parser.add_argument(
        "--config", default=default, help=f"a preset or a YAML file (default: {default})"
    )
    parser.add_argument(
        "--set",
        dest="assignments",
        action="append",
        default=[],
        metavar="KEY=VALUE",
        help="change a parameter; may be given several times",
    )


def add_seed(parser: argparse.ArgumentParser) -> None:
    """Add the seed of random numbers."""
    parser.add_argument("--seed", type=int, default=0, help="seed of random numbers (default: 0)")


def load_config(arguments: argparse.Namespace, assignments: Sequence[str] = ()) -> Config:
    """Return the configuration that was chosen, with further assignments."""
    chosen = configs.resolve(arguments.config)
    return configs.override(chosen, [*arguments.assignments, *assignments])


def open_sequence(path: Path, arguments: argparse.Namespace) -> Dataset:
    """Open a sequence, cut to ``--max-frames``."""
    dataset = registry.open_dataset(path)
    n_frames: int | None = arguments.max_frames
    if n_frames is None or n_frames >= len(dataset):
        return dataset
    if n_frames < 1:
        raise ValueError(f"--max-frames must be at least 1, got {n_frames}")
    return SequenceSlice(dataset, 0, n_frames)


def true_poses(dataset: Dataset) -> Array:
    """Return ``T_world_camera`` (N, 4, 4) of every frame; ``DatasetError`` if one is unknown."""
    groundtruth = dataset.groundtruth()
    if groundtruth is None or not np.isfinite(groundtruth.poses).all():
        raise DatasetError(
            f"{dataset.sequence}: found no ground truth of every frame, expected poses to judge by"
        )
    return groundtruth.poses


def use_one_thread() -> None:
    """Let numerical libraries of this process and its children use one thread."""
    for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(variable, "1")


def show_progress(what: str, done: int, total: int, *, every: int = 20) -> None:
    """Print the progress of a task to stderr, on one line."""
    if done % every == 0 or done == total:
        end = "\n" if done == total else ""
        print(f"\r{what}: {done}/{total}", end=end, file=sys.stderr, flush=True)


def cell(value: object) -> str:
    """Return a figure as text: four digits of a float, ``-`` for what is unknown.

    >>> [cell(value) for value in (0.012344, 12, True, None, "twin")]
    ['0.01234', '12', 'yes', '-', 'twin']
    """
    if value is None or (isinstance(value, float) and np.isnan(value)):
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    return f"{value:.4g}" if isinstance(value, float) else str(value)


class Table:
    """A table that is printed row by row, as the measuring goes on.

    ``columns`` are the headings by key. Rows are figures by key; what has no column is printed by
    ``--json`` only. Without a heading a row would be unreadable, so the first row prints it.
    """

    def __init__(self, columns: Mapping[str, str], arguments: argparse.Namespace) -> None:
        self.columns = dict(columns)
        self._as_json: bool = arguments.json
        self._as_markdown: bool = arguments.markdown
        self._has_heading = False

    def row(self, figures: Mapping[str, Any]) -> None:
        """Print a row."""
        if self._as_json:
            print(json.dumps(dict(figures), default=float), flush=True)
            return
        if not self._has_heading:
            self._print(list(self.columns.values()))
            if self._as_markdown:
                self._print(["---"] * len(self.columns))
            self._has_heading = True
        self._print([cell(figures.get(key)) for key in self.columns])

    def note(self, text: str) -> None:
        """Print a line beside the table; with ``--json`` to stderr."""
        if self._as_json:
            print(text, file=sys.stderr, flush=True)
        elif self._as_markdown:
            print(f"\n{text}\n", flush=True)
            self._has_heading = False
        else:
            print(text, flush=True)

    def _print(self, cells: Sequence[str]) -> None:
        if self._as_markdown:
            print(f"| {' | '.join(cells)} |", flush=True)
            return
        first, *rest = self.columns.values()
        texts = [f"{cells[0]:{max(len(first), 28)}}"]
        widths = [max(len(heading), MIN_CELL) for heading in rest]
        texts += [f"{text:>{width}}" for text, width in zip(cells[1:], widths, strict=True)]
        print(" ".join(texts), flush=True)


def run(
    parser: argparse.ArgumentParser, measure: Callable[[argparse.Namespace], int | None]
) -> int:
    """Parse the command line and measure; return the exit code, 1 after an error in one line."""
    arguments = parser.parse_args()
    try:
        return measure(arguments) or 0
    except (SlamBofError, ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
