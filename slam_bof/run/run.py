"""One run of the mini-SLAM over a sequence, new or resumed."""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from slam_bof.core import StageClock, Usage, registry
from slam_bof.errors import MapError
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.run.folder import as_run_errors, link_map, logging_to, make_folder
from slam_bof.run.logging_observer import LoggingObserver
from slam_bof.run.metrics import Metrics, compute_metrics
from slam_bof.run.outputs import write_outputs, write_trajectory
from slam_bof.run.record import RunRecord
from slam_bof.scenes import label_map, model as models
from slam_bof.slam import (
    Config,
    LoopCloser,
    MiniSlam,
    SlamResult,
    config as configs,
    of_session,
)
from slam_bof.store import MapStore, MapWriter, Session, SessionResult, replay_keyframes

__all__ = ["RunInterrupted", "RunResult", "resume_sequence", "run_sequence"]

LEFT_OUT_REASON = "inconsistent with the other loops in the final optimisation"
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
            config = _with_model_of(earlier, config)
    job = _Job.prepare(dataset, config, observer, max_frames)
    with ExitStack() as stack:
        store = None
        if map_file is not None:
            # Opened first: a damaged map, or one in use, must leave no folder behind.
            store = stack.enter_context(_open_map(map_file))
            _check_ready(store, dataset, job.closer.map.model_hash)
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
        return _run(job, folder, store, session, is_new=True)


def resume_sequence(
    dataset: Dataset,
    map_file: Path,
    out: Path,
    *,
    observer: Observer | None = None,
    max_frames: int | None = None,
    remarks: Sequence[str] = (),
) -> RunResult:
    """Resume an interrupted run after its last saved keyframe.

    The configuration is the one saved in the map. The files go to the run's own folder if the map
    is in it, otherwise to a new one. Odometry runs again over the frames before the last keyframe.
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
        config = _with_model_of(store, config)
        job = _Job.prepare(dataset, config, observer, max_frames or session.max_frames)
        _check_ready(store, dataset, job.closer.map.model_hash, is_new=False)
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
    clock: StageClock
    odometry: Odometry
    closer: LoopCloser

    @classmethod
    def prepare(
        cls, dataset: Dataset, config: Config, observer: Observer | None, max_frames: int | None
    ) -> _Job:
        """Build the odometry and the plug-in that the configuration names."""
        clock = StageClock()
        odometry = registry.build("odometry", config.odometry.name, config.odometry.options)
        closer = LoopCloser.from_config(config, clock=clock)
        logging_observer = LoggingObserver(observer or NullObserver())
        return cls(dataset, config, logging_observer, max_frames, clock, odometry, closer)


def _open_map(map_file: Path) -> MapStore:
    """Open a map to add a session to it; create it if it does not exist."""
    if map_file.exists():
        return MapStore.open(map_file, read_only=False)
    return MapStore.create(map_file)


def _run(job: _Job, folder: Path, store: MapStore, session: Session, *, is_new: bool) -> RunResult:
    """Run a session to its end, from its start or its last saved keyframe, and write its files."""
    closer = job.closer
    started = Usage.now()
    with MapWriter(store) as writer:
        _restore(closer, store, session, is_new=is_new)
        closer.journal = writer.write
        slam = MiniSlam(job.odometry, closer, observer=job.observer, clock=job.clock)
        try:
            result = slam.run(job.dataset, max_frames=job.max_frames)
        except KeyboardInterrupt:
            raise RunInterrupted(folder, job.observer.n_frames) from None
    write_trajectory(folder, "odometry", result.odometry)
    write_trajectory(folder, "optimized", result.optimized)
    used = Usage.now() - started
    if closer.n_frames_lost > MAX_LOST_RATIO * len(result.indices):
        job.observer.on_warning(
            f"{closer.n_frames_lost} of {len(result.indices)} frames are lost: too little depth, "
            "or too little overlap with earlier frames"
        )
    record = _finish(job, store, session, result, used)
    metrics = compute_metrics(record)
    write_outputs(folder, record, metrics)
    logger.info("done: %d keyframes, %s loops", len(result.keyframes), metrics["n_loops"])
    return RunResult(folder, metrics)


def _finish(
    job: _Job, store: MapStore, session: Session, result: SlamResult, used: Usage
) -> RunRecord:
    """Label the whole map, finish the session in it, and return the record of the run."""
    dataset, config, closer = job.dataset, job.config, job.closer
    T_map_camera, first = closer.map.backend.poses(), closer.map.first_keyframe
    smoothed, rooms = label_map(
        closer.map.keyframes,
        T_map_camera,
        config.labels,
        config.rooms,
        components=closer.map.components,
    )
    store.finish(
        session.id,
        SessionResult(
            frames=closer.frames_since_keyframe,
            T_map_camera=T_map_camera,
            smoothed=smoothed,
            regions=rooms,
            left_out=closer.map.loops_left_out,
            reason=LEFT_OUT_REASON,
        ),
    )
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
        usage=used,
        clock=job.clock,
    )


def _restore(closer: LoopCloser, store: MapStore, session: Session, *, is_new: bool) -> None:
    """Restore the closer from the map; begin the session in both if it is new."""
    closer.restore(replay_keyframes(store, reopened_session=None if is_new else session.id))
    while closer.map.session < session.id:
        closer.begin_session()
    if is_new:
        store.set_parameters({"model": closer.map.model_hash})
        store.begin_session(session)


def _with_model_of(store: MapStore, config: Config) -> Config:
    """Return the configuration with the model that the map was made with, if it is included."""
    name = models.name_by_hash(config.model, store.parameters().get("model"))
    return config.model_copy(update={"model": name})


def _check_ready(store: MapStore, dataset: Dataset, model: str, *, is_new: bool = True) -> None:
    """Check that a session of the data set can be added to the map, or its last one resumed."""
    sessions, found = store.sessions(), store.parameters().get("model", model)
    if is_new and sessions and not sessions[-1].is_finished:
        raise MapError(
            f"{store.path}: found an interrupted run of {sessions[-1].sequence}, "
            "expected a finished one: resume it first"
        )
    if found != model:
        raise MapError(
            f"{store.path}: found a map made with model {found[:12]}, expected {model[:12]}: "
            "all sessions of a map use one model"
        )
    camera = store.intrinsics()
    if camera not in (None, dataset.intrinsics):
        raise MapError(
            f"{store.path}: found {camera}, expected {dataset.intrinsics}, the camera of "
            f"{dataset.sequence}: all sessions of a map use one camera"
        )


def _is_folder_of(folder: Path, session: Session) -> bool:
    """Return whether a folder is the one of a session's run, not of an earlier, finished run."""
    has_ended = (folder / "metrics.json").exists()
    is_own = session.is_finished and session.id == 0 if has_ended else True
    return (folder / "config.yaml").exists() and is_own


def _begin_log(dataset: Dataset, remarks: Sequence[str]) -> None:
    for remark in remarks:
        logger.info(remark)
    logger.info("%s of %s, %d frames", dataset.sequence, dataset.name, len(dataset))
