"""``slam-bof run`` with several sequences."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from slam_bof.cli.inputs import open_sequence
from slam_bof.cli.one_line import one_line

if TYPE_CHECKING:
    from slam_bof.run import RunOptions
    from slam_bof.slam import Config

__all__ = ["run_many"]


def run_many(
    sequences: list[Path],
    config: Config,
    out: Path,
    options: RunOptions,
    *,
    n_jobs: int | None,
    scheduler: str | None,
    frames: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run sequences in folders of their own and print a table of all; exit with 1 if one failed."""
    from slam_bof.cli.console import Bar, print_json, print_table
    from slam_bof.core import on_cluster
    from slam_bof.run import run_sequences

    open_ = partial(open_sequence, choice=config.dataset, frames=frames, quiet=True)
    done = []
    with (
        nullcontext() if scheduler is None else on_cluster(scheduler),
        Bar("Running sequences", quiet=quiet) as bar,
    ):
        found = run_sequences(sequences, open_, config, out, options, n_jobs=n_jobs, frames=frames)
        for one in found:
            done.append(one)
            bar.show(len(done), len(sequences))
    if as_json:
        print_json(
            [
                {"sequence_path": str(one.sequence), "error": one.error}
                if one.result is None
                else {"folder": str(one.result.folder), **one.result.metrics}
                for one in done
            ]
        )
    else:
        keys = ("ate_odometry_m", "ate_m", "n_loops", "n_keyframes", "n_components", "fps")
        rows = [
            (one.sequence, *map(one.result.metrics.get, keys), one.result.folder)
            for one in done
            if one.result is not None
        ]
        print_table(("sequence", *keys, "folder"), rows)
    failed = [one for one in done if one.result is None]
    for one in failed:
        typer.echo(f"error: {one_line(str(one.error))}", err=True)
    if failed:
        typer.echo(f"{len(failed)} of {len(done)} sequences failed", err=True)
        raise typer.Exit(1)
