"""What the commands print with: JSON and tables on stdout, progress and warnings on stderr."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from types import TracebackType
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
from rich.table import Table

from slam_bof.types import EdgeKind

if TYPE_CHECKING:
    from slam_bof.types import Step

__all__ = ["Bar", "Bars", "FrameBar", "print_json", "print_table"]

UNLIMITED = 10_000
"""Columns of a terminal that no table fills."""


def print_json(value: Any) -> None:
    """Print a value as JSON, and nothing else; what is not a number there becomes null."""
    typer.echo(json.dumps(_plain(value), indent=2, allow_nan=False))


def print_table(
    columns: Sequence[str], rows: Iterable[Sequence[object]], *, title: str = ""
) -> None:
    """Print rows under column names, as wide as the terminal; in full where there is none."""
    console = Console(highlight=False)
    table = Table(*columns, title=title or None, title_justify="left")
    for row in rows:
        table.add_row(*(_text(value) for value in row))
    if not console.is_terminal:
        unlimited = console.options.update(width=UNLIMITED)
        console.width = max(console.width, console.measure(table, options=unlimited).maximum)
    console.print(table)


class Bar:
    """A progress bar on stderr; without a terminal a line for each tenth, or nothing at all.

    One that is not ``live`` is drawn only when it is told of progress: no thread of its own
    takes time from what is being measured.
    """

    def __init__(self, what: str, *, quiet: bool = False, live: bool = True) -> None:
        self._console = Console(stderr=True, quiet=quiet, highlight=False, soft_wrap=True)
        self._what = what
        self._live = live
        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[note]}"),
            console=self._console,
            disable=quiet or not self._console.is_terminal,
            auto_refresh=live,
        )
        self._task = self._progress.add_task(what, total=None, note="")
        self._told = 0

    def __enter__(self) -> Self:
        """Show the bar."""
        self._progress.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Leave the bar as it stands."""
        self._progress.stop()

    def show(self, done: int, total: int, note: str = "") -> None:
        """Tell how far the work has come."""
        self._progress.update(
            self._task, completed=done, total=total, note=note, refresh=not self._live
        )
        tenth = 10 * done // total if total else 10
        if not self._console.is_terminal and tenth > self._told:
            self._told = tenth
            self._console.print(f"{self._what}: {done}/{total} {note}".rstrip())

    def warn(self, message: str) -> None:
        """Print a warning above the bar."""
        self._console.print(f"warning: {message}", markup=False)


class Bars(ExitStack):
    """A progress bar for each thing that is done, one after the other; none is ``live``."""

    def __init__(self, *, quiet: bool) -> None:
        super().__init__()
        self._quiet = quiet
        self._bars: dict[str, Bar] = {}

    def show(self, what: str, done: int, total: int) -> None:
        """Tell how far it has come."""
        if what not in self._bars:
            self.close()
            self._bars[what] = self.enter_context(Bar(what, quiet=self._quiet, live=False))
        self._bars[what].show(done, total)


class FrameBar(Bar):
    """The observer of a run that shows it as a progress bar."""

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
    return f"{round(value, 3) + 0.0:.3f}" if isinstance(value, float) else str(value)


def _plain(value: Any) -> Any:
    """Return a value as JSON can have it."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and (value != value or abs(value) == float("inf")):
        return None
    return value
