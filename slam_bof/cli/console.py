"""Printing: JSON and tables on stdout, progress and warnings on stderr.

Text is printed as it is, never read as Rich markup: paths may have brackets.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import TYPE_CHECKING, Any, Self

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.table import Column, Table
from rich.text import Text

from slam_bof.cli.one_line import escape

if TYPE_CHECKING:
    from slam_bof.types import Step

__all__ = ["Bar", "Bars", "FrameBar", "print_json", "print_table"]

MAX_TEXT = 28
"""Characters of a cell from which on it is wrapped where space is short."""
FRAME = 3
"""Characters of a table's frame and padding for each column."""


def print_json(value: Any) -> None:
    """Print a value as JSON, with null for NaN and infinity."""
    typer.echo(json.dumps(_plain(value), indent=2, allow_nan=False))


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = ""
) -> None:
    """Print rows under column names, in full if stdout is not a terminal.

    Columns that do not fit side by side on the terminal follow in further tables, each with the
    first column repeated.
    """
    console = Console(highlight=False)
    columns = [escape(name) for name in columns]
    cells = [[_text(value) for value in row] for row in rows]
    widths = [
        max(len(line) for cell in column for line in cell.splitlines() or [""])
        for column in zip(columns, *cells, strict=True)
    ]
    if not console.is_terminal:
        console.width = max(console.width, sum(widths) + FRAME * len(widths) + 1)
    for number, chosen in enumerate(_fit(widths, console.width)):
        table = Table(
            *(_column(columns[k], widths[k]) for k in chosen),
            title=Text(escape(title)) if title and not number else None,
            title_justify="left",
        )
        for row in cells:
            table.add_row(*(Text(row[k]) for k in chosen))
        console.print(table)


def _fit(widths: Sequence[int], limit: int) -> list[list[int]]:
    """Return which columns to print side by side, in as few tables as their widths allow."""
    tables: list[list[int]] = [[]]
    used = 1
    for k, width in enumerate(widths):
        needed = min(width, MAX_TEXT) + FRAME
        if len(tables[-1]) > 1 and used + needed > limit:
            tables.append([0])
            used = 1 + min(widths[0], MAX_TEXT) + FRAME
        tables[-1].append(k)
        used += needed
    return tables


def _column(name: str, width: int) -> Column:
    """Return a column that wraps only long text."""
    return Column(Text(name), no_wrap=width <= MAX_TEXT, overflow="fold")


class Bar:
    """A progress bar on stderr; without a terminal, a line for each tenth.

    A bar that is not ``live`` is drawn only when progress is reported, without a thread that
    would take time from what is being measured.
    """

    def __init__(self, what: str, *, quiet: bool = False, live: bool = True) -> None:
        self._console = Console(stderr=True, quiet=quiet, highlight=False, soft_wrap=True)
        self._what = what = escape(what)
        self._live = live
        self._progress = Progress(
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}", markup=False),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
            auto_refresh=live,
        )
        self._task = self._progress.add_task(what, total=None, note="")
        self._n_tenths = 0

    def __enter__(self) -> Self:
        """Show the bar."""
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Leave the bar as it stands."""
        self._progress.stop()

    def show(self, done: int, total: int, note: str = "") -> None:
        """Report how much of the work is done."""
        self._progress.update(
            self._task, completed=done, total=total, note=note, refresh=not self._live
        )
        tenth = 10 * done // total if total else 10
        if not self._console.is_terminal and tenth > self._n_tenths:
            self._n_tenths = tenth
            self._print(f"{self._what}: {done}/{total} {note}".rstrip())

    def warn(self, message: str) -> None:
        """Print a warning above the bar."""
        self._print(f"warning: {message}")

    def _print(self, text: str) -> None:
        self._console.print(escape(text), markup=False, emoji=False)


class Bars(ExitStack):
    """Progress bars of tasks that are done one after the other; none is ``live``."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__()
        self._quiet = quiet
        self._bars: dict[str, Bar] = {}

    def show(self, what: str, done: int, total: int) -> None:
        """Report how much of a task is done."""
        if what not in self._bars:
            self.close()
            self._bars[what] = self.enter_context(Bar(what, quiet=self._quiet, live=False))
        self._bars[what].show(done, total)


class FrameBar(Bar):
    """An observer that shows a run as a progress bar."""

    def __init__(self, what: str, *, quiet: bool = False) -> None:
        super().__init__(what, quiet=quiet)
        self._n_frames = 0
        self._n_keyframes = 0
        self._n_loops = 0

    def on_start(self, n_frames: int) -> None:
        """Show an empty bar."""
        self._n_frames = n_frames
        self.show(0, n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Move the bar on."""
        from slam_bof.types import EdgeKind

        self._n_keyframes += step.keyframe is not None
        self._n_loops += sum(loop.kind == EdgeKind.LOOP for loop in step.loops)
        scene = f", {step.scene.label}" if step.scene else ""
        note = f"{self._n_keyframes} keyframes, {self._n_loops} loops{scene}"
        self.show(frame_index + 1, self._n_frames, note)

    def on_warning(self, message: str) -> None:
        """Print it."""
        self.warn(message)


def _text(value: object) -> str:
    if value is None:
        return "-"
    # Adding 0 makes a negative zero positive.
    return f"{round(value, 3) + 0.0:.3f}" if isinstance(value, float) else escape(str(value))


def _plain(value: Any) -> Any:
    """Return a value with only what JSON has."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and (value != value or abs(value) == float("inf")):
        return None
    return value
