"""``slam-bof evaluate places``: recall, precision and cost of place recognition."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.options import JOBS, JSON, N_WORDS, QUIET, SCHEDULER, SEED, SET, out_file

if TYPE_CHECKING:
    from slam_bof.evaluation import MethodScores, PlaceQueries

__all__ = ["places"]

TRUTHS = ("pose", "overlap")


def places(
    sequences: Annotated[list[Path], typer.Argument(help="Sequences with ground truth.")],
    descriptors: Annotated[
        str,
        typer.Option(help="Descriptor plug-ins and recogniser, separated by commas; or all."),
    ] = "all",
    train: Annotated[
        list[Path] | None, typer.Option(help="A sequence to learn visual words from.")
    ] = None,
    every: Annotated[int, typer.Option(min=1, help="Use every n-th frame.")] = 5,
    min_age: Annotated[int, typer.Option(min=1, help="Least age of an answer in frames.")] = 101,
    n_words: N_WORDS = 1024,
    odometry: Annotated[
        str, typer.Option(help="Odometry plug-in used with the recogniser.")
    ] = "kiss-icp",
    assignments: SET = None,
    seed: SEED = 0,
    curves: Annotated[
        Path | None,
        typer.Option(
            callback=out_file, help="HTML file to write with the precision-recall curves."
        ),
    ] = None,
    misses: Annotated[
        Path | None,
        typer.Option(callback=out_file, help="HTML file to write with the wrong answers."),
    ] = None,
    jobs: JOBS = 1,
    scheduler: SCHEDULER = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Print recall, precision and cost of place recognition, by pose and by overlap.

    Parameters of the recogniser are those of loops.recogniser.
    """
    from slam_bof.cli.console import Bar, print_json
    from slam_bof.core import on_cluster, registry
    from slam_bof.evaluation import RECOGNISER, ProtocolParams, evaluate_places
    from slam_bof.slam import config as configs
    from slam_bof.visualization import MissedQueries, find_missed_queries, write_missed_queries

    names = [RECOGNISER, *registry.names("descriptors")]
    chosen = names if descriptors == "all" else [name.strip() for name in descriptors.split(",")]
    for name in chosen:
        if name != RECOGNISER:
            registry.load("descriptors", name)
    config = configs.override(configs.resolve("indoor"), assignments or [])
    missed: list[MissedQueries] = []

    def collect_misses(queries: PlaceQueries, scores: MethodScores) -> None:
        found = find_missed_queries(scores.scores, queries.relevant["overlap"], queries.allowed)
        missed.append(MissedQueries(scores.method, queries.dataset, queries.indices, *found))

    with (
        nullcontext() if scheduler is None else on_cluster(scheduler),
        Bar("Places", quiet=quiet) as bar,
    ):
        rows = evaluate_places(
            [registry.open_dataset(path) for path in sequences],
            chosen,
            training=[registry.open_dataset(path) for path in train or []],
            params=ProtocolParams(every=every, min_age_frames=min_age),
            n_words=n_words,
            recogniser=config.loops.recogniser,
            odometry=odometry,
            seed=seed,
            n_jobs=jobs if scheduler is None else None,
            on_progress=lambda what, done, total: bar.show(done, total, what),
            on_scores=collect_misses,
        )
    if curves is not None:
        _write_curves(rows, curves)
    if misses is not None:
        write_missed_queries(misses, missed)
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

    evaluated = [row for row in rows if "left_out" not in row]
    for kind in TRUTHS:
        table = []
        for row in evaluated:
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
            "recall at precision 1",
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
