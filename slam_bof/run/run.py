"""One run of the mini-SLAM over a sequence, and everything that it leaves in its folder."""

from __future__ import annotations

import importlib.metadata
import logging
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path

from slam_bof.core import StageClock, Usage, registry
from slam_bof.errors import MapError
from slam_bof.maps import write_map
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.run.folder import (
    link_map,
    logging_to,
    make_folder,
    naming_errors,
    write_audit_trail,
    write_metrics,
    write_trajectory,
)
from slam_bof.run.metrics import Metrics, compute_metrics
from slam_bof.scenes import label_map
from slam_bof.slam import Config, LoopCloser, MiniSlam, config as configs, of_session
from slam_bof.store import MapStore, MapWriter, Session, SessionResult, read_records
from slam_bof.types import Step
from slam_bof.visualization import ReportData, write_report

__all__ = ["RunResult", "resume_sequence", "run_sequence"]

LEFT_OUT = "contradicts the other loops, weighed all together at the end"
MANY_LOST = 0.1
"""Share of lost frames above which a run says so."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Where a run's files are, and its metrics as ``metrics.json`` has them."""

    folder: Path
    metrics: Metrics


class Watcher:
    """The observer of a run: logs where odometry is lost and what goes wrong, passes all on."""

    def __init__(self, observer: Observer) -> None:
        self._observer = observer
        self._is_lost = False

    def on_start(self, n_frames: int) -> None:
        """Pass on."""
        self._observer.on_start(n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Log where odometry is lost and found."""
        if step.is_lost != self._is_lost:
            self._is_lost = step.is_lost
            logger.warning(
                "frame %d: odometry %s", frame_index, "lost" if step.is_lost else "found"
            )
        self._observer.on_step(frame_index, step)

    def on_warning(self, message: str) -> None:
        """Log and pass on."""
        logger.warning(message)
        self._observer.on_warning(message)


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
        What to run, and how.
    out
        Where the run gets its folder.
    map_file
        A map that the sequence is to be joined to, as another session; if there is none yet, it
        is made. By default the run makes a map of its own in its folder.
    observer
        Looks on.
    max_frames
        Stop after so many.
    remarks
        Lines for the head of ``run.log``.

    Raises
    ------
    RunError
        If the folder cannot be made or written.
    SlamBofError
        Whatever else the user can mend: the model, a plug-in, the data set, the map.
    """
    config = configs.complete(config)
    job = _Job.prepare(dataset, config, observer, max_frames)
    with ExitStack() as stack:
        store = None
        if map_file is not None:
            # First of all, so that a bad one, or one in use, leaves no folder behind.
            is_there = map_file.exists()
            store = (
                MapStore.open(map_file, read_only=False) if is_there else MapStore.create(map_file)
            )
            stack.enter_context(store)
            _check_ready(store, dataset, job.closer.model_hash)
        folder = make_folder(out)
        stack.enter_context(naming_errors(folder))
        stack.enter_context(logging_to(folder / "run.log"))
        _begin_log(dataset, remarks)
        (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
        if store is None:
            store = stack.enter_context(MapStore.create(folder / "map.db"))
        else:
            link_map(folder, store.path)
        session = Session(
            len(store.sessions()),
            dataset.name,
            dataset.sequence,
            configs.dump(config),
            config.seed,
            importlib.metadata.version("slam-bof"),
            max_frames,
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
    """Go on with an interrupted run after its last keyframe, to the end that it would have had.

    The configuration is that of the run, and so is its folder where the map is in it; the odometry
    is run again over the frames before. A run that was at its end writes its files again.

    Raises
    ------
    RunError
        If the folder cannot be written.
    SlamBofError
        Whatever else the user can mend: the map is of another sequence, or none to resume.
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
        config = configs.parse(session.config, f"{map_file}: session {session.id}")
        job = _Job.prepare(dataset, config, observer, max_frames or session.max_frames)
        _check_ready(store, dataset, job.closer.model_hash, is_new=False)
        is_in_folder = _is_folder_of(map_file.parent, session)
        folder = map_file.parent if is_in_folder else make_folder(out)
        with naming_errors(folder), logging_to(folder / "run.log"):
            _begin_log(dataset, remarks)
            if not is_in_folder:
                (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
                link_map(folder, map_file)
            return _run(job, folder, store, session, is_new=False)


@dataclass(frozen=True, slots=True)
class _Job:
    """What a run does, and with what; made before anything is written."""

    dataset: Dataset
    config: Config
    observer: Observer
    max_frames: int | None
    clock: StageClock
    odometry: Odometry
    closer: LoopCloser

    @classmethod
    def prepare(
        cls, dataset: Dataset, config: Config, observer: Observer | None, max_frames: int | None
    ) -> _Job:
        """Build the parts that the configuration names."""
        clock = StageClock()
        odometry = registry.build("odometry", config.odometry.name, config.odometry.options)
        closer = LoopCloser.from_config(config, clock=clock)
        watcher = Watcher(observer or NullObserver())
        return cls(dataset, config, watcher, max_frames, clock, odometry, closer)


def _run(job: _Job, folder: Path, store: MapStore, session: Session, *, is_new: bool) -> RunResult:
    """Run a session from where the map has it to its end, and write its files."""
    dataset, config, closer = job.dataset, job.config, job.closer
    started = Usage.now()
    with MapWriter(store) as writer:
        _restore(closer, store, session, is_new=is_new)
        closer.journal = writer.write
        slam = MiniSlam(job.odometry, closer, observer=job.observer, clock=job.clock)
        result = slam.run(dataset, max_frames=job.max_frames)
    write_trajectory(folder, "odometry", result.odometry)
    write_trajectory(folder, "optimized", result.optimized)
    used = Usage.now() - started
    if closer.n_frames_lost > MANY_LOST * len(result.indices):
        job.observer.on_warning(
            f"{closer.n_frames_lost} of {len(result.indices)} frames are lost: too little "
            "depth, or too little in common with what was seen before"
        )
    T_map_camera = closer.backend.poses()
    smoothed, regions = label_map(
        closer.keyframes, T_map_camera, config.labels, config.regions, parts=closer.parts
    )
    left_out = closer.loops_left_out
    store.finish(
        session.id,
        SessionResult(
            closer.frames_since_keyframe, T_map_camera, smoothed, regions, left_out, LEFT_OUT
        ),
    )
    first = closer.first_keyframe
    candidates = of_session(store.candidates(), range(first, len(closer.keyframes)))
    closer.backend.write_g2o(folder / "pose_graph.g2o")
    groundtruth = dataset.groundtruth()
    scenes = dataset.scenes()
    frames = [int(result.indices[k.frame_index]) for k in result.keyframes]
    true_scenes = None if scenes is None else [scenes[i] for i in frames]
    metrics = compute_metrics(
        dataset_name=dataset.name,
        sequence=dataset.sequence,
        result=result,
        closer=closer,
        candidates=candidates,
        groundtruth=groundtruth,
        true_scenes=true_scenes,
        smoothed=smoothed[first:],
        n_regions=len(regions),
        usage=used,
        clock=job.clock,
        seed=config.seed,
    )
    write_metrics(folder / "metrics.json", metrics)
    if groundtruth is not None:
        write_trajectory(folder, "groundtruth", groundtruth)
    write_audit_trail(folder / "loops.csv", candidates, result.keyframes)
    write_map(folder / "map.ply", dataset, frames, result.T_map_camera)
    write_report(
        folder / "report.html",
        ReportData(
            metrics=metrics,
            odometry=result.odometry,
            optimized=result.optimized,
            groundtruth=groundtruth,
            keyframes=[
                replace(keyframe, smoothed=scene)
                for keyframe, scene in zip(result.keyframes, smoothed[first:], strict=True)
            ],
            loops=result.loops,
            candidates=candidates,
            true_scenes=true_scenes,
        ),
    )
    logger.info("done: %d keyframes, %s loops", len(result.keyframes), metrics["n_loops"])
    return RunResult(folder, metrics)


def _restore(closer: LoopCloser, store: MapStore, session: Session, *, is_new: bool) -> None:
    """Bring the closer to where the map has the session, and begin it if it is new."""
    closer.restore(read_records(store, as_before=None if is_new else session.id))
    while closer.session < session.id:
        closer.begin_session()
    if is_new:
        store.set_parameters({"model": closer.model_hash})
        store.begin_session(session)


def _check_ready(store: MapStore, dataset: Dataset, model: str, *, is_new: bool = True) -> None:
    """Check that the map can take the data set as another session, or go on with its last one."""
    sessions, found = store.sessions(), store.parameters().get("model", model)
    if is_new and sessions and not sessions[-1].is_finished:
        raise MapError(
            f"{store.path}: found that its last run, of {sessions[-1].sequence}, was interrupted, "
            "expected a finished one: resume it first"
        )
    if found != model:
        raise MapError(
            f"{store.path}: found words of model {found[:12]}, expected those of {model[:12]}: "
            "a map is of one model"
        )
    camera = store.intrinsics()
    if camera not in (None, dataset.intrinsics):
        raise MapError(
            f"{store.path}: found {camera}, expected {dataset.intrinsics}, the camera of "
            f"{dataset.sequence}: a map is of one camera"
        )


def _is_folder_of(folder: Path, session: Session) -> bool:
    """Tell whether a folder is that of a session's run, and not of one that had ended before."""
    has_ended = (folder / "metrics.json").exists()
    is_own = session.is_finished and session.id == 0 if has_ended else True
    return (folder / "config.yaml").exists() and is_own


def _begin_log(dataset: Dataset, remarks: Sequence[str]) -> None:
    for remark in remarks:
        logger.info(remark)
    logger.info("%s of %s, %d frames", dataset.sequence, dataset.name, len(dataset))
