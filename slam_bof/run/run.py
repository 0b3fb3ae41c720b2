"""Where a run begins and where its files go: a new one, or one that is resumed."""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from slam_bof.errors import MapError
from slam_bof.maps import check_session, with_model_of
from slam_bof.ports import Dataset, Observer, ScaledDataset
from slam_bof.run.folder import as_run_errors, link_map, logging_to, make_folder
from slam_bof.run.job import Job, RunResult, run_job
from slam_bof.run.options import RunOptions
from slam_bof.slam import Config, LoopCloser, config as configs
from slam_bof.store import MapStore, Session

__all__ = ["resume_sequence", "run_sequence"]

WHOLE = RunOptions()
"""All frames, and a map without colour in its own frame."""

logger = logging.getLogger(__name__)


def run_sequence(
    dataset: Dataset,
    config: Config,
    out: Path,
    options: RunOptions = WHOLE,
    *,
    map_file: Path | None = None,
    observer: Observer | None = None,
    source: str = "",
    remarks: Sequence[str] = (),
) -> RunResult:
    """Run the mini-SLAM over a sequence and write everything into a new folder under ``out``.

    Parameters
    ----------
    dataset, config
        The sequence and all parameters.
    out
        The folder in which the run's folder is created.
    options
        How far the run goes, and how it writes ``map.ply``.
    map_file
        A map to which the sequence is added as another session; it is created if it does not
        exist. By default the run creates a map of its own in its folder.
    observer
        Is informed of every step and warning.
    source
        Where the sequence is, to be kept in the map for ``run --resume``.
    remarks
        First lines of ``run.log``.

    Raises
    ------
    RunError
        If the folder cannot be created or written.
    SlamBofError
        If the model, a plug-in, the data set or the map is missing or unusable.
    """
    config = configs.complete(config)
    if map_file is not None and map_file.exists():
        with MapStore.open(map_file) as earlier:
            config = with_model_of(earlier, config)
    job = Job.prepare(dataset, config, observer, options)
    with ExitStack() as stack:
        store = None
        if map_file is not None:
            # Opened first: a damaged map, or one in use, must leave no folder behind.
            store = stack.enter_context(_open_map(map_file))
            _check_ready(store, dataset, job.closer)
        folder = make_folder(out)
        stack.enter_context(as_run_errors(folder))
        stack.enter_context(logging_to(folder / "run.log"))
        _begin_log(dataset, remarks)
        (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
        if store is None:
            store = stack.enter_context(MapStore.create(folder / "map.db"))
        else:
            link_map(folder, store.path)
        session = Session(
            id=len(store.sessions()),
            dataset=dataset.name,
            sequence=dataset.sequence,
            config=configs.dump(config),
            seed=config.seed,
            version=importlib.metadata.version("slam-bof"),
            max_frames=options.max_frames,
        )
        store.set_parameters({"source": source, "units_per_m": _units_per_m(dataset)})
        return run_job(job, folder, store, session, is_new=True)


def resume_sequence(
    dataset: Dataset,
    map_file: Path,
    out: Path,
    options: RunOptions = WHOLE,
    *,
    observer: Observer | None = None,
    remarks: Sequence[str] = (),
) -> RunResult:
    """Resume an interrupted run after its last saved keyframe.

    The configuration is the one saved in the map. The files go to the run's own folder if the map
    is in it, otherwise to a new one. The odometry goes on from its last saved state; if it cannot
    save it, it runs again over the frames before the last keyframe.
    A run that was finished writes its files again.

    Raises
    ------
    RunError
        If the folder cannot be written.
    SlamBofError
        If the map has no run to resume, or its run is of another sequence.
    """
    with MapStore.open(map_file, read_only=False) as store:
        sessions = store.sessions()
        if not sessions:
            raise MapError(f"{map_file}: found no session in it, expected an interrupted run")
        session = sessions[-1]
        found, expected = (dataset.name, dataset.sequence), (session.dataset, session.sequence)
        if found != expected:
            raise MapError(
                f"{map_file}: found a run of {' '.join(expected)}, expected one of "
                f"{' '.join(found)}"
            )
        config = configs.parse_saved(session.config, f"{map_file}: session {session.id}")
        config = with_model_of(store, config)
        options = replace(options, max_frames=options.max_frames or session.max_frames)
        job = Job.prepare(dataset, config, observer, options)
        _check_ready(store, dataset, job.closer, is_new=False)
        is_in_folder = _is_folder_of(map_file.parent, session)
        folder = map_file.parent if is_in_folder else make_folder(out)
        with as_run_errors(folder), logging_to(folder / "run.log"):
            _begin_log(dataset, remarks)
            if not is_in_folder:
                (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
                link_map(folder, map_file)
            return run_job(job, folder, store, session, is_new=False)


def _open_map(map_file: Path) -> MapStore:
    """Open a map to add a session to it; create it if it does not exist."""
    if map_file.exists():
        return MapStore.open(map_file, read_only=False)
    return MapStore.create(map_file)


def _check_ready(
    store: MapStore, dataset: Dataset, closer: LoopCloser, *, is_new: bool = True
) -> None:
    """Check that a session of the data set can be added to the map, or its last one resumed."""
    sessions = store.sessions()
    if is_new and sessions and not sessions[-1].is_finished:
        raise MapError(
            f"{store.path}: found an interrupted run of {sessions[-1].sequence}, expected a "
            f"finished one: resume it, or slam-bof map finish {store.path}"
        )
    check_session(store, dataset.intrinsics, dataset.sequence, closer)


def _units_per_m(dataset: Dataset) -> float | None:
    """Return the unit of depth of the sequence's images, where it is known."""
    return float(dataset.units_per_m) if isinstance(dataset, ScaledDataset) else None


def _is_folder_of(folder: Path, session: Session) -> bool:
    """Return whether a folder is the one of a session's run, not of an earlier, finished run."""
    has_ended = (folder / "metrics.json").exists()
    is_own = session.is_finished and session.id == 0 if has_ended else True
    return (folder / "config.yaml").exists() and is_own


def _begin_log(dataset: Dataset, remarks: Sequence[str]) -> None:
    for remark in remarks:
        logger.info(remark)
    logger.info("%s of %s, %d frames", dataset.sequence, dataset.name, len(dataset))
