"""One run of the mini-SLAM over a sequence, new or resumed."""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from slam_bof.core import StageClock, Usage, registry
from slam_bof.datasets import find_doubts, first_frame
from slam_bof.errors import MapError
from slam_bof.maps import check_session, finish_session, restore_session, with_model_of
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry, ScaledDataset
from slam_bof.run.folder import as_run_errors, link_map, logging_to, make_folder
from slam_bof.run.logging_observer import LoggingObserver
from slam_bof.run.metrics import Metrics, compute_metrics
from slam_bof.run.outputs import write_outputs, write_trajectory
from slam_bof.run.record import RunRecord
from slam_bof.slam import (
    Config,
    LoopCloser,
    MiniSlam,
    SlamResult,
    config as configs,
    of_session,
)
from slam_bof.store import MapStore, MapWriter, Session

__all__ = ["RunInterrupted", "RunResult", "resume_sequence", "run_sequence"]

MAX_LOST_RATIO = 0.1
"""Share of lost frames above which a run warns."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Where a run's files are, and its metrics as ``metrics.json`` has them."""

    folder: Path
    metrics: Metrics


class RunInterrupted(KeyboardInterrupt):
    """Ctrl-C during a run, whose saved keyframes can be resumed from its folder."""

    def __init__(self, folder: Path, n_frames: int) -> None:
        super().__init__(f"{folder}: interrupted after {n_frames} frames")
        self.folder = folder
        self.n_frames = n_frames


def run_sequence(
    dataset: Dataset,
    config: Config,
    out: Path,
    *,
    map_file: Path | None = None,
    observer: Observer | None = None,
    max_frames: int | None = None,
    with_color: bool = False,
    z_up: bool = False,
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
    map_file
        A map to which the sequence is added as another session; it is created if it does not
        exist. By default the run creates a map of its own in its folder.
    observer
        Is informed of every step and warning.
    max_frames
        Stop after this many frames.
    with_color
        Give the points of ``map.ply`` the data set's colour, which may show people.
    z_up
        Write ``map.ply`` in a frame with z up and 0 on the floor instead of that of the map.
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
    job = _Job.prepare(dataset, config, observer, max_frames, with_color=with_color, z_up=z_up)
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
            max_frames=max_frames,
        )
        store.set_parameters({"source": source, "units_per_m": _units_per_m(dataset)})
        return _run(job, folder, store, session, is_new=True)


def resume_sequence(
    dataset: Dataset,
    map_file: Path,
    out: Path,
    *,
    observer: Observer | None = None,
    max_frames: int | None = None,
    with_color: bool = False,
    z_up: bool = False,
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
        n_frames = max_frames or session.max_frames
        job = _Job.prepare(dataset, config, observer, n_frames, with_color=with_color, z_up=z_up)
        _check_ready(store, dataset, job.closer, is_new=False)
        is_in_folder = _is_folder_of(map_file.parent, session)
        folder = map_file.parent if is_in_folder else make_folder(out)
        with as_run_errors(folder), logging_to(folder / "run.log"):
            _begin_log(dataset, remarks)
            if not is_in_folder:
                (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
                link_map(folder, map_file)
            return _run(job, folder, store, session, is_new=False)


@dataclass(frozen=True, slots=True)
class _Job:
    """The parts of a run, built before anything is written."""

    dataset: Dataset
    config: Config
    observer: LoggingObserver
    max_frames: int | None
    with_color: bool
    z_up: bool
    clock: StageClock
    odometry: Odometry
    closer: LoopCloser

    @classmethod
    def prepare(
        cls,
        dataset: Dataset,
        config: Config,
        observer: Observer | None,
        max_frames: int | None,
        *,
        with_color: bool,
        z_up: bool,
    ) -> _Job:
        """Build the odometry and the plug-in that the configuration names."""
        clock = StageClock()
        return cls(
            dataset=dataset,
            config=config,
            observer=LoggingObserver(observer or NullObserver(), first_frame(dataset)),
            max_frames=max_frames,
            with_color=with_color,
            z_up=z_up,
            clock=clock,
            odometry=registry.build("odometry", config.odometry.name, config.odometry.options),
            closer=LoopCloser.from_config(config, clock=clock),
        )


def _open_map(map_file: Path) -> MapStore:
    """Open a map to add a session to it; create it if it does not exist."""
    if map_file.exists():
        return MapStore.open(map_file, read_only=False)
    return MapStore.create(map_file)


def _run(job: _Job, folder: Path, store: MapStore, session: Session, *, is_new: bool) -> RunResult:
    """Run a session to its end, from its start or its last saved keyframe, and write its files."""
    closer = job.closer
    started = Usage.now()
    doubts = find_doubts(job.dataset)
    for doubt in doubts:
        job.observer.on_warning(doubt)
    with MapWriter(store) as writer:
        odometry = None if is_new else store.odometry(session.id)
        restore_session(closer, store, session, is_new=is_new)
        slam = MiniSlam(job.odometry, closer, observer=job.observer, clock=job.clock)
        closer.journal = lambda record: writer.write(record, slam.odometry_state(record))
        health = job.observer.health.saved_in(folder / "health.csv", len(closer.history))
        with _resumable(folder, job), health:
            result = slam.run(job.dataset, max_frames=job.max_frames, odometry=odometry)
        if result.n_resumed:
            logger.info(
                "resumed after %d frames; the odometry ran again over %d of them",
                result.n_resumed,
                result.n_repeated,
            )
    with _resumable(folder, job):
        return _conclude(job, folder, store, session, result, started, doubts)


@contextmanager
def _resumable(folder: Path, job: _Job) -> Iterator[None]:
    """Raise ``RunInterrupted`` for Ctrl-C."""
    try:
        yield
    except KeyboardInterrupt:
        raise RunInterrupted(folder, job.observer.n_frames) from None


def _conclude(
    job: _Job,
    folder: Path,
    store: MapStore,
    session: Session,
    result: SlamResult,
    started: Usage,
    doubts: Sequence[str],
) -> RunResult:
    """Finish a session whose frames are all read, and write the files of its run."""
    closer = job.closer
    write_trajectory(folder, "odometry", result.odometry)
    write_trajectory(folder, "optimized", result.optimized)
    used = Usage.now() - started
    if closer.n_frames_lost > MAX_LOST_RATIO * len(result.indices):
        reason = "too little depth, or too little overlap with earlier frames"
        if doubts:
            reason = "probably for the reason that the warning at the start of the run gives"
        job.observer.on_warning(
            f"{closer.n_frames_lost} of {len(result.indices)} frames are lost: {reason}"
        )
    record = _finish(job, store, session, result, used)
    if closer.map.n_components > 1:
        job.observer.on_warning(
            f"the map has {closer.map.n_components} components that no loop has joined: poses of "
            "different components are not comparable, and map.ply shows the largest"
        )
    metrics = compute_metrics(record)
    write_outputs(folder, record, metrics, store, job.observer.on_warning)
    logger.info("done: %d keyframes, %s loops", len(result.keyframes), metrics["n_loops"])
    return RunResult(folder, metrics)


def _finish(
    job: _Job, store: MapStore, session: Session, result: SlamResult, used: Usage
) -> RunRecord:
    """Label the whole map, finish the session in it, and return the record of the run."""
    dataset, config, closer = job.dataset, job.config, job.closer
    first = closer.map.first_keyframe
    smoothed, rooms = finish_session(closer, store, session, config, warn=job.observer.on_warning)
    scenes = dataset.scenes()
    frame_indices = [int(result.indices[k.frame_index]) for k in result.keyframes]
    return RunRecord(
        dataset=dataset,
        closer=closer,
        seed=config.seed,
        result=result,
        candidates=of_session(store.candidates(), range(first, len(closer.map.keyframes))),
        smoothed=smoothed[first:],
        n_rooms=len(rooms),
        groundtruth=dataset.groundtruth(),
        true_scenes=None if scenes is None else [scenes[i] for i in frame_indices],
        with_color=job.with_color,
        z_up=job.z_up,
        live=job.observer.health.trajectory(result.optimized.stamps_s),
        health=job.observer.health.frames,
        usage=used,
        clock=job.clock,
    )


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
