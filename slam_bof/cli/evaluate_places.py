"""``slam-bof evaluate``: how often a description finds the place again; scene labels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.evaluate_scenes import scenes
from slam_bof.cli.options import JSON, QUIET

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from slam_bof.evaluation import Scored
    from slam_bof.ports import Dataset

__all__ = ["evaluate"]

TRUTHS = ("pose", "overlap")

evaluate = typer.Typer(help="Judge descriptions of frames by ground truth.", no_args_is_help=True)


@evaluate.callback()
def _group() -> None:
    """Judge descriptions of frames by ground truth."""


evaluate.command()(scenes)


@evaluate.command()
def places(
    sequences: Annotated[list[Path], typer.Argument(help="Sequences with ground truth.")],
    descriptors: Annotated[
        str,
        typer.Option(help="Plug-ins by name, or recogniser, with commas between; or all."),
    ] = "all",
    train: Annotated[
        list[Path] | None, typer.Option(help="A sequence to learn visual words of.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Each so many frames asks and answers.")] = 5,
    min_age: Annotated[int, typer.Option(min=1, help="Frames an answer is older.")] = 101,
    n_words: Annotated[int, typer.Option("--words", min=2, help="Of each vocabulary.")] = 1024,
    odometry: Annotated[
        str, typer.Option(help="Plug-in that the recogniser is beside.")
    ] = "kiss-icp",
    seed: Annotated[int, typer.Option(min=0, help="Of what is drawn at random.")] = 0,
    curves: Annotated[
        Path | None, typer.Option(help="HTML file to write the precision-recall curves to.")
    ] = None,
    misses: Annotated[
        Path | None, typer.Option(help="HTML file to show what was missed in, by overlap.")
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Print recall, precision and cost of place recognition, by pose and by overlap."""
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.core import registry
    from slam_bof.evaluation import RECOGNISER, ProtocolParams, evaluate_places
    from slam_bof.visualization import Missed, find_misses, write_misses

    names = [RECOGNISER, *registry.names("descriptors")]
    chosen = names if descriptors == "all" else [name.strip() for name in descriptors.split(",")]
    for name in chosen:
        if name != RECOGNISER:
            registry.load("descriptors", name)
    missed: list[Missed] = []

    def look(
        dataset: Dataset,
        indices: Sequence[int],
        scored: Scored,
        right: dict[str, NDArray[np.bool_]],
        allowed: NDArray[np.bool_],
    ) -> None:
        found = find_misses(scored.scores, right["overlap"], allowed)
        missed.append(Missed(scored.method, dataset, indices, *found))

    with Bar("Places", quiet=quiet) as bar:
        rows = evaluate_places(
            [registry.open_dataset(path) for path in sequences],
            chosen,
            training=[registry.open_dataset(path) for path in train or []],
            params=ProtocolParams(every=every, min_age_frames=min_age),
            n_words=n_words,
            odometry=odometry,
            seed=seed,
            on_progress=lambda what, done, total: bar.show(done, total, what),
            on_scored=look,
        )
    if curves is not None:
        _write_curves(rows, curves)
    if misses is not None:
        write_misses(misses, missed)
    if as_json:
        print_json(rows)
    else:
        _print(rows)


def _write_curves(rows: list[dict[str, Any]], path: Path) -> None:
    import numpy as np

    from slam_bof.visualization import draw_precision_recall

    several = len({row["sequence"] for row in rows}) > 1
    by_truth = {
        kind: {
            f"{row['descriptor']}, {row['sequence']}" if several else row["descriptor"]: np.array(
                row[kind]["curve"]
            )
            for row in rows
            if row.get(kind)
        }
        for kind in TRUTHS
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    draw_precision_recall(by_truth).write_html(path)


def _print(rows: list[dict[str, Any]]) -> None:
    from slam_bof.cli.console import print_table

    judged = [row for row in rows if "left_out" not in row]
    for kind in TRUTHS:
        table = []
        for row in judged:
            figures = row[kind]
            shares: list[object] = [None] * 6
            if figures:
                shares = [
                    *figures["recall_at"].values(),
                    figures["average_precision"],
                    figures["recall_at_full_precision"],
                ]
            n_queries = figures["n_queries"] if figures else 0
            cost = (row["describe_ms"], row["query_ms"], round(row["bytes_per_frame"]))
            table.append([row["sequence"], row["descriptor"], n_queries, *shares, *cost])
        columns = (
            "R@1",
            "R@5",
            "R@10",
            "R@20",
            "AP",
            "recall at P = 1",
            "CPU ms",
            "query ms",
            "bytes",
        )
        print_table(
            ("sequence", "descriptor", "queries", *columns), table, title=f"Truth by {kind}"
        )
    for row in rows:
        if "left_out" in row:
            typer.echo(f"{row['sequence']}: {row['descriptor']} is left out: {row['left_out']}.")
