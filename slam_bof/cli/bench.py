"""``slam-bof bench``: the cost of BOF, SIFT and ORB, as in Tables 7 to 9 of the paper."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from slam_bof.cli.options import JSON, N_WORDS, QUIET, SEED

__all__ = ["bench"]

PROCESSES = (
    "1 descriptors of one frame",
    "2 descriptors of all frames",
    "3 vocabulary",
    "4 TF-IDF bags of all frames",
    "5 training of the classifier",
    "6 classification of all frames",
    "7 representation (2 + 4)",
    "8 offline phase (3 + 5)",
    "9 online phase (2 + 4 + 6)",
)
MEMORY = (
    ("descriptors", "descriptor_bytes"),
    ("descriptors, packed", "packed_bytes"),
    ("TF-IDF bags", "bag_bytes"),
    ("codebook", "codebook_bytes"),
    ("classifier", "classifier_bytes"),
)


def bench(
    data: Annotated[
        list[Path], typer.Option("--data", help="A sequence; each of several is a class.")
    ],
    n_frames: Annotated[
        int | None,
        typer.Option("--frames", min=4, help="Frames per sequence, evenly spaced."),
    ] = None,
    n_words: N_WORDS = 1024,
    index_sizes: Annotated[
        list[int] | None,
        typer.Option("--index-size", min=1, help="Keyframes in the index when timing queries."),
    ] = None,
    seed: SEED = 0,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Compare the cost of BOF, SIFT and ORB: CPU time, memory and queries (one thread)."""
    from slam_bof.cli.console import Bars, print_json
    from slam_bof.core import registry
    from slam_bof.evaluation import run_bench

    datasets = [registry.open_dataset(path) for path in data]
    with Bars(quiet=quiet) as bars:
        figures = run_bench(
            datasets,
            n_frames=n_frames,
            n_words=n_words,
            index_sizes=index_sizes or (10_000, 1_000_000),
            seed=seed,
            on_progress=bars.show,
        )
    if as_json:
        print_json(figures)
    else:
        _print(figures)


def _print(figures: dict[str, Any]) -> None:
    from slam_bof.cli.console import print_table

    methods: dict[str, dict[str, Any]] = figures["methods"]
    names = list(methods)
    sequences = ", ".join(figures["sequences"])
    typer.echo(
        f"{sequences}: {figures['frames']} frames, one thread, decoding "
        f"({figures['decode_ms']:.1f} ms per frame) not counted."
    )
    if len(figures["sequences"]) == 1:
        typer.echo(
            f"The classes are {len(figures['classes'])} segments of the sequence, for timing only."
        )
    for name, why in figures["left_out"].items():
        typer.echo(f"{name} is left out: {why}.")

    times = {n: (methods[n]["process_cpu_s"], methods[n]["process_wall_s"]) for n in names}
    print_table(
        ["CPU s / real s", *names],
        [[what, *(_pair(times[name], what[0], 3) for name in names)] for what in PROCESSES],
        title="Table 7: time",
    )
    increases = figures["increases"]
    if increases:
        shares = [(pair["cpu_percent"], pair["wall_percent"]) for pair in increases.values()]
        print_table(
            ["CPU % / real %", *increases],
            [[what, *(_pair(share, what[0], 0) for share in shares)] for what in PROCESSES],
            title="Table 8: increase",
        )
    print_table(
        ["MB", *names],
        [
            [what, *(_scaled(methods[name].get(key), 1e-6) for name in names)]
            for what, key in MEMORY
        ],
        title="Table 9: memory",
    )
    _print_frames(figures, methods)


def _print_frames(figures: dict[str, Any], methods: dict[str, dict[str, Any]]) -> None:
    from slam_bof.cli.console import print_table

    names, n_frames = list(methods), figures["frames"]
    sift = methods.get("SIFT", {})
    rows: list[list[object]] = [
        ["descriptors", *(methods[name]["descriptors"] / n_frames for name in names)],
        ["describe, CPU ms (median)", *(methods[name]["describe_ms"] for name in names)],
        ["bag of words, CPU ms (median)", *(methods[name]["bag_ms"] for name in names)],
        ["codebook, samples", *(methods[name]["samples"] for name in names)],
        ["codebook, words", *(methods[name]["words"] for name in names)],
        [
            "descriptors packed, bytes",
            *(_scaled(methods[n].get("packed_bytes"), 1 / n_frames) for n in names),
        ],
        ["words kept when packed", *(methods[name].get("packed_words_kept") for name in names)],
    ]
    if sift:
        rows += [
            ["SIFT / describe", *(sift["describe_ms"] / methods[n]["describe_ms"] for n in names)],
            [
                "SIFT bytes / packed bytes",
                *(_ratio(sift["descriptor_bytes"], methods[n].get("packed_bytes")) for n in names),
            ],
        ]
    for key, what in (("recall", "recall@{}"), ("packed_recall", "recall@{} when packed")):
        if any(methods[name].get(key) for name in names):
            rows += [
                [what.format(k), *((methods[n].get(key) or {}).get(k) for n in names)]
                for k in ("1", "5", "10")
            ]
    print_table(["per frame", *names], rows)
    print_table(
        ["keyframes", "query, CPU ms (median)", "add, CPU ms", "bytes per keyframe"],
        [
            [n, row["query_ms"], row["add_ms"], row["bytes_per_keyframe"]]
            for n, row in figures["index"].items()
        ],
        title="Inverted index, BOF 20 layers",
    )


def _pair(columns: tuple[dict[str, Any], dict[str, Any]], process: str, digits: int) -> str:
    """Return CPU time and real time of a process as text."""
    values = [column[process] for column in columns]
    return " / ".join("-" if value is None else f"{value:.{digits}f}" for value in values)


def _scaled(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _ratio(value: float, by: float | None) -> float | None:
    return value / by if by else None
