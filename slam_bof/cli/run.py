"""Commands that compute: ``run`` and ``demo``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.options import FRAMES, JSON, OUT, QUIET, SET
from slam_bof.cli.query import map_file

if TYPE_CHECKING:
    from slam_bof.ports import Dataset
    from slam_bof.run import RunResult
    from slam_bof.slam import Config

__all__ = ["demo", "open_sequence", "run"]

SUMMARY = (
    ("ATE of odometry", "ate_odometry_m", "m"),
    ("ATE after loops", "ate_m", "m"),
    ("Times that odometry was lost", "n_odometry_lost", ""),
    ("Parts of the map", "n_parts", ""),
    ("Loops accepted", "n_loops", ""),
    ("Loops that are right", "loop_precision", "share"),
    ("Scene labels that are right", "scene_accuracy", "share"),
    ("Frames", "n_frames", ""),
    ("Keyframes", "n_keyframes", ""),
    ("Speed", "fps", "frames/s"),
    ("Peak memory", "peak_rss_mb", "MB"),
)


def run(
    sequence: Annotated[
        Path, typer.Argument(help="Folder of a sequence of depth frames, or a .bag or .sens file.")
    ],
    out: OUT = Path("runs"),
    config: Annotated[
        str, typer.Option("--config", "-c", metavar="PRESET|FILE", help="Parameters.")
    ] = "indoor",
    assignments: SET = None,
    dataset: Annotated[
        str | None,
        typer.Option(
            help="Layout of the folder, as slam-bof plugins lists them; auto looks at it. "
            "Its options: --set dataset.options.KEY=VALUE."
        ),
    ] = None,
    model: Annotated[str | None, typer.Option(help="Model file, or default.")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Of all that is random.")] = None,
    frames: FRAMES = None,
    max_frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many.")] = None,
    map_: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP",
            help="Join the sequence to this map, as another session; made if there is none.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP",
            help="Go on with an interrupted run, after the last keyframe in its map.db or folder.",
        ),
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Run the mini-SLAM over a sequence: trajectory, loops, labels and map into a new folder."""
    from slam_bof.slam import config as configs

    if resume is not None:
        given_too = {
            "--map": map_ is not None,
            "--config": config != "indoor",
            "--set": bool(assignments),
            "--dataset": dataset is not None,
            "--model": model is not None,
            "--seed": seed is not None,
        }
        result = _resume(
            sequence, resume, out, given_too, frames=frames, max_frames=max_frames, quiet=quiet
        )
        _show(result, as_json=as_json)
        return
    chosen = configs.override(configs.resolve(config), assignments or [])
    given: dict[str, Any] = {"model": model, "seed": seed}
    if dataset is not None:
        given["dataset"] = chosen.dataset.model_copy(update={"name": dataset})
    chosen = chosen.model_copy(update={k: v for k, v in given.items() if v is not None})
    place = None if map_ is None else map_file(map_)
    result = _run(
        sequence, chosen, out, frames=frames, max_frames=max_frames, quiet=quiet, place=place
    )
    _show(result, as_json=as_json)


def demo(
    out: OUT = Path("runs"),
    seed: Annotated[int, typer.Option(min=0, help="Of the flat, the tour and the run.")] = 0,
    max_frames: Annotated[int | None, typer.Option(min=1, help="Stop after so many.")] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Walk through a synthetic flat, made once and kept, and show what loops do for the map."""
    from slam_bof import synthetic
    from slam_bof.cli.console import Bar
    from slam_bof.slam import config as configs

    # A shortened tour gets a place of its own, so as not to take that of the whole one.
    folder = _cache() / (f"seed-{seed}" + (f"-first-{max_frames}" if max_frames else ""))
    with Bar("Making a flat", quiet=quiet) as bar:
        sequence = synthetic.write_flat(folder, seed=seed, n_frames=max_frames, progress=bar.show)
    config = configs.preset("indoor").model_copy(update={"seed": seed})
    result = _run(sequence, config, out, max_frames=max_frames, quiet=quiet)
    _show(result, as_json=as_json)


def _run(
    sequence: Path,
    config: Config,
    out: Path,
    *,
    max_frames: int | None,
    quiet: bool,
    frames: str | None = None,
    place: Path | None = None,
) -> RunResult:
    from slam_bof.cli.console import FrameBar
    from slam_bof.run import run_sequence

    dataset, remarks = open_sequence(sequence, config, frames, quiet=quiet)
    with FrameBar(dataset.sequence, quiet=quiet) as observer:
        return run_sequence(
            dataset,
            config,
            out,
            map_file=place,
            observer=observer,
            max_frames=max_frames,
            remarks=remarks,
        )


def _resume(
    sequence: Path,
    map_: Path,
    out: Path,
    given_too: dict[str, bool],
    *,
    frames: str | None,
    max_frames: int | None,
    quiet: bool,
) -> RunResult:
    from slam_bof.cli.console import FrameBar
    from slam_bof.errors import ConfigError, MapError
    from slam_bof.run import resume_sequence
    from slam_bof.slam import config as configs
    from slam_bof.store import MapStore

    wrong = [option for option, is_given in given_too.items() if is_given]
    if wrong:
        raise ConfigError(
            f"{', '.join(wrong)}: found with --resume, expected without: a run goes on as it began"
        )
    place = map_file(map_)
    with MapStore.open(place) as store:
        sessions = store.sessions()
    if not sessions:
        raise MapError(f"{place}: found no session in it, expected an interrupted run")
    config = configs.parse(sessions[-1].config, str(place))
    dataset, remarks = open_sequence(sequence, config, frames, quiet=quiet)
    with FrameBar(dataset.sequence, quiet=quiet) as observer:
        return resume_sequence(
            dataset, place, out, observer=observer, max_frames=max_frames, remarks=remarks
        )


def open_sequence(
    sequence: Path, config: Config, frames: str | None, *, quiet: bool
) -> tuple[Dataset, list[str]]:
    """Open the data set; return it and what there is to say of how it was recognised."""
    from slam_bof.core import registry
    from slam_bof.datasets import Excerpt
    from slam_bof.errors import DatasetError
    from slam_bof.ports import LabelledImages

    name, remarks = config.dataset.name, []
    if name == "auto":
        found = registry.recognise_dataset(sequence)
        name, remarks = found.name, [f"{sequence}: {found}"]
        if not quiet:
            typer.echo(remarks[0], err=True)
    dataset = registry.open_dataset(sequence, name, config.dataset.options)
    if isinstance(dataset, LabelledImages):
        raise DatasetError(
            f"{sequence}: found single images of {name}, expected a sequence; "
            "they are for training and judging scene labels"
        )
    return (dataset if frames is None else Excerpt.parse(dataset, frames)), remarks


def _show(result: RunResult, *, as_json: bool) -> None:
    from slam_bof.cli.console import print_json, print_table

    if as_json:
        print_json({"folder": str(result.folder), **result.metrics})
        return
    rows = [(what, result.metrics.get(key), unit) for what, key, unit in SUMMARY]
    print_table(("", "value", "unit"), rows, title=str(result.metrics["sequence"]))
    typer.echo(f"Files: {result.folder}")
    typer.echo(f"Report: {result.folder / 'report.html'}")


def _cache() -> Path:
    """Return the folder for what can be made again."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "slam_bof"
