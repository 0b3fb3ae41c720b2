"""``slam-bof run``: the mini-SLAM over a sequence, new or resumed."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slam_bof.cli.inputs import map_file, open_sequence
from slam_bof.cli.options import FRAMES, JOBS, JSON, MAX_FRAMES, OUT, QUIET, SCHEDULER, SET
from slam_bof.cli.run_many import run_many
from slam_bof.errors import ConfigError

if TYPE_CHECKING:
    from slam_bof.ports import Dataset, Observer
    from slam_bof.run import RunOptions, RunResult
    from slam_bof.slam import Config

__all__ = ["run", "run_new"]

INTERRUPTED = 130
"""Exit code of a program that SIGINT has ended, by the convention of shells."""

SUMMARY = (
    ("ATE of odometry alone", "ate_odometry_m", "m"),
    ("ATE with loops", "ate_m", "m"),
    ("Losses of odometry", "n_odometry_lost", ""),
    ("Map components", "n_components", ""),
    ("Loops accepted", "n_loops", ""),
    ("Correct loops", "loop_precision", "share"),
    ("Correct scene labels (single image)", "scene_accuracy", "share"),
    ("Correct scene labels (smoothed)", "scene_accuracy_smoothed", "share"),
    ("Frames", "n_frames", ""),
    ("Keyframes", "n_keyframes", ""),
    ("Speed", "fps", "frames/s"),
    ("Peak memory", "peak_rss_mb", "MB"),
)


def run(
    sequences: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="SEQUENCE...",
            help="Folder of a sequence of depth images, or a .bag or .sens file. With --resume it "
            "may be left out if the data are where they were. Several sequences are run one by "
            "one, each in a folder of its own.",
        ),
    ] = None,
    out: OUT = Path("runs"),
    config: Annotated[
        str, typer.Option("--config", "-c", metavar="PRESET|FILE", help="Configuration.")
    ] = "indoor",
    assignments: SET = None,
    dataset: Annotated[
        str | None,
        typer.Option(
            help="Layout of the sequence, a name that slam-bof plugins lists; by default it is "
            "recognised. Set its options with --set dataset.options.KEY=VALUE."
        ),
    ] = None,
    model: Annotated[str | None, typer.Option(help="Model file, default or synthetic.")] = None,
    seed: Annotated[
        int | None,
        typer.Option(min=0, max=2**32 - 1, help="Seed of everything random, below 2^32."),
    ] = None,
    frames: FRAMES = None,
    max_frames: MAX_FRAMES = None,
    map_: Annotated[
        Path | None,
        typer.Option(
            "--map",
            metavar="MAP",
            help="Add the sequence to this map as another session; it is created if missing.",
        ),
    ] = None,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="MAP",
            help="Resume the interrupted run of this map.db or folder after its last keyframe.",
        ),
    ] = None,
    color: Annotated[
        bool, typer.Option("--color", help="Give map.ply the data set's colour, if it has any.")
    ] = False,
    z_up: Annotated[
        bool, typer.Option("--z-up", help="Write map.ply in a frame with z up, 0 on the floor.")
    ] = False,
    jobs: JOBS = 1,
    scheduler: SCHEDULER = None,
    view: Annotated[
        str | None,
        typer.Option(
            metavar="live|FILE.rrd",
            help="Show the run in the viewer of rerun as it goes on, or record it for that.",
        ),
    ] = None,
    as_json: JSON = False,
    quiet: QUIET = False,
) -> None:
    """Run the mini-SLAM over a sequence; write trajectory, loops, labels and map to a folder."""
    from slam_bof.run import RunOptions

    sequences = sequences or []
    sequence = sequences[0] if sequences else None
    if scheduler is not None and len(sequences) < 2:
        raise typer.BadParameter("found --scheduler with one sequence, expected several")
    if len(sequences) > 1 and (resume is not None or map_ is not None):
        option = "--map" if resume is None else "--resume"
        raise typer.BadParameter(f"found {len(sequences)} sequences with {option}, expected one")
    if sequence is None and resume is None:
        raise typer.BadParameter("found no SEQUENCE, expected one, or --resume")
    options = RunOptions(max_frames=max_frames, with_color=color, z_up=z_up)
    if resume is not None:
        _refuse_with_resume(
            {
                "--map": map_ is not None,
                "--config": config != "indoor",
                "--set": bool(assignments),
                "--dataset": dataset is not None,
                "--model": model is not None,
                "--seed": seed is not None,
            }
        )
        _resume(
            sequence,
            map_file(resume),
            out,
            options,
            frames=frames,
            view=view,
            quiet=quiet,
            as_json=as_json,
        )
        return
    chosen = _configuration(config, assignments or [], dataset=dataset, model=model, seed=seed)
    if len(sequences) > 1:
        run_many(
            sequences,
            chosen,
            out,
            options,
            n_jobs=jobs if scheduler is None else None,
            scheduler=scheduler,
            frames=frames,
            quiet=quiet,
            as_json=as_json,
        )
        return
    run_new(
        sequences[0],
        chosen,
        out,
        options,
        frames=frames,
        map_=None if map_ is None else map_file(map_),
        view=view,
        quiet=quiet,
        as_json=as_json,
    )


def _refuse_with_resume(given: dict[str, bool]) -> None:
    """Refuse options that were given although the run is resumed."""
    wrong = [option for option, is_given in given.items() if is_given]
    if wrong:
        raise ConfigError(
            f"{', '.join(wrong)}: found with --resume, expected without: a resumed run keeps "
            "its configuration"
        )


def _configuration(
    name: str, assignments: list[str], *, dataset: str | None, model: str | None, seed: int | None
) -> Config:
    """Return the configuration of a name, changed by the options that were given."""
    from slam_bof.slam import config as configs

    config = configs.override(configs.resolve(name), assignments)
    values: dict[str, Any] = {"model": model, "seed": seed}
    if dataset is not None:
        values["dataset"] = config.dataset.model_copy(update={"name": dataset})
    return config.model_copy(update={k: v for k, v in values.items() if v is not None})


def run_new(
    sequence: Path,
    config: Config,
    out: Path,
    options: RunOptions,
    *,
    frames: str | None = None,
    map_: Path | None = None,
    view: str | None = None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Run a sequence in a new folder and print the result."""
    from slam_bof.run import run_sequence

    dataset, remarks = open_sequence(sequence, config.dataset, frames, quiet=quiet)
    with _observer(sequence, dataset, frames, view, quiet=quiet) as observer:
        result = run_sequence(
            dataset,
            config,
            out,
            options,
            map_file=map_,
            observer=observer,
            source=json.dumps({"path": str(sequence.resolve()), "frames": frames}),
            remarks=remarks,
        )
        if view is not None:
            _view_map(observer, result.folder)
    _show(result, as_json=as_json)


def _resume(
    sequence: Path | None,
    map_: Path,
    out: Path,
    options: RunOptions,
    *,
    frames: str | None,
    view: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Resume the last run of a map and print the result."""
    from slam_bof.errors import MapError
    from slam_bof.run import resume_sequence
    from slam_bof.slam import config as configs
    from slam_bof.store import MapStore

    with MapStore.open(map_) as store:
        sessions, source = store.sessions(), store.parameters().get("source", "")
    if not sessions:
        raise MapError(f"{map_}: found no session in it, expected an interrupted run")
    config = configs.parse_saved(sessions[-1].config, str(map_))
    if sequence is None:
        saved = json.loads(source or "{}")
        sequence, frames = Path(saved.get("path", "")), frames or saved.get("frames")
        if not source or not sequence.exists():
            raise MapError(
                f"{map_}: found no data of {sessions[-1].sequence} at {saved.get('path')}, "
                "expected the sequence: slam-bof run SEQUENCE --resume FOLDER"
            )
    dataset, remarks = open_sequence(sequence, config.dataset, frames, quiet=quiet)
    with _observer(sequence, dataset, frames, view, quiet=quiet) as observer:
        result = resume_sequence(dataset, map_, out, options, observer=observer, remarks=remarks)
        if view is not None:
            _view_map(observer, result.folder)
    _show(result, as_json=as_json)
    if not as_json:
        metrics = result.metrics
        typer.echo(
            f"Resumed after {metrics['n_frames_resumed']} frames; the odometry ran again over "
            f"{metrics['n_frames_repeated']} of them."
        )


@contextmanager
def _observer(
    sequence: Path, dataset: Dataset, frames: str | None, view: str | None, *, quiet: bool
) -> Iterator[Observer]:
    """Show a run as a progress bar; if it is interrupted, print how to resume it and exit."""
    from slam_bof.cli.console import FrameBar
    from slam_bof.run import RunInterrupted

    try:
        with ExitStack() as stack:
            observer: Observer = stack.enter_context(FrameBar(dataset.sequence, quiet=quiet))
            if view is not None:
                from slam_bof.visualization import LiveView

                observer = stack.enter_context(LiveView(observer, dataset, view))
            yield observer
    except RunInterrupted as interruption:
        words = ["slam-bof", "run", str(sequence), "--resume", str(interruption.folder)]
        if frames is not None:
            words += ["--frames", frames]
        typer.echo(
            f"interrupted after {interruption.n_frames} frames; go on with: {shlex.join(words)}",
            err=True,
        )
        raise typer.Exit(INTERRUPTED) from None


def _view_map(live: Any, folder: Path) -> None:
    """Show the finished map in the view of a run."""
    from slam_bof.errors import MapError
    from slam_bof.maps import show_finished_map
    from slam_bof.store import MapStore

    try:
        with MapStore.open(folder / "map.db") as store:
            show_finished_map(store, live.recording)
    except MapError as error:  # without a keyframe
        live.on_warning(str(error))


def _show(result: RunResult, *, as_json: bool) -> None:
    from slam_bof.cli.console import print_json, print_table

    if as_json:
        print_json({"folder": str(result.folder), **result.metrics})
        return
    rows = [(what, result.metrics.get(key), unit) for what, key, unit in SUMMARY]
    print_table(("metric", "value", "unit"), rows, title=str(result.metrics["sequence"]))
    offset_s = result.metrics.get("groundtruth_offset_s")
    if offset_s:
        typer.echo(f"Judged by true poses with {offset_s} s added to their time stamps")
    typer.echo(f"Files: {result.folder}")
    typer.echo(f"Report: {result.folder / 'report.html'}")
