"""A run of the mini-SLAM from its parts to its files, wherever these go."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from slam_bof.core import StageClock, Usage, registry, unwrap_interruption
from slam_bof.datasets import find_doubts, first_frame
from slam_bof.errors import FrameWarning
from slam_bof.geometry import delayed
from slam_bof.maps import finish_session, restore_session
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.run.logging_observer import LoggingObserver
from slam_bof.run.metrics import Metrics, compute_metrics
from slam_bof.run.options import RunOptions
from slam_bof.run.outputs import write_outputs, write_trajectory
from slam_bof.run.record import RunRecord
from slam_bof.slam import (
    Config,
    LoopCloser,
    MiniSlam,
    SlamResult,
    find_odometry_doubts,
    of_session,
)
from slam_bof.store import MapStore, MapWriter, Session

__all__ = ["Job", "RunInterrupted", "RunResult", "run_job"]

MAX_LOST_RATIO = 0.1
"""Share of lost frames above which a run warns."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Where a run's files are, and its metrics in the form of ``metrics.json``."""

    folder: Path
    metrics: Metrics


class RunInterrupted(KeyboardInterrupt):
    """Ctrl-C during a run, whose saved keyframes can be resumed from its folder."""

    def __init__(self, folder: Path, n_frames: int) -> None:
        super().__init__(f"{folder}: interrupted after {n_frames} frames")
        self.folder = folder
        self.n_frames = n_frames


@dataclass(frozen=True, slots=True)
class Job:
    """The parts of a run, built before anything is written."""

    dataset: Dataset
    config: Config
    observer: LoggingObserver
    options: RunOptions
    clock: StageClock
    odometry: Odometry
    closer: LoopCloser

    @classmethod
    def prepare(
        cls,
        dataset: Dataset,
        config: Config,
        observer: Observer | None,
        options: RunOptions,
    ) -> Job:
        """Build the odometry and the plug-in that the configuration names."""
        clock = StageClock()
        return cls(
            dataset=dataset,
            config=config,
            observer=LoggingObserver(observer or NullObserver(), first_frame(dataset)),
            options=options,
            clock=clock,
            odometry=registry.build("odometry", config.odometry.name, config.odometry.options),
            closer=LoopCloser.from_config(config, clock=clock),
        )


def run_job(
    job: Job, folder: Path, store: MapStore, session: Session, *, is_new: bool
) -> RunResult:
    """Run a session to its end, from its start or its last saved keyframe, and write its files."""
    closer = job.closer
    started = Usage.now()
    doubts = find_doubts(job.dataset, job.config.sensor)
    for doubt in doubts:
        job.observer.on_warning(doubt)
    with _resumable(folder, job), warnings.catch_warnings():
        warnings.simplefilter("ignore", FrameWarning)  # the doubts say the same
        with MapWriter(store) as writer:
            odometry = None if is_new else store.odometry(session.id)
            restore_session(closer, store, session, is_new=is_new)
            slam = MiniSlam(job.odometry, closer, observer=job.observer, clock=job.clock)
            closer.journal = lambda record: writer.write(record, slam.odometry_state(record))
            with job.observer.health.saved_in(folder / "health.csv", len(closer.history)):
                result = slam.run(job.dataset, max_frames=job.options.max_frames, odometry=odometry)
            if result.n_resumed:
                logger.info(
                    "resumed after %d frames; the odometry ran again over %d of them",
                    result.n_resumed,
                    result.n_repeated,
                )
        return _conclude(job, folder, store, session, result, started, doubts)


@contextmanager
def _resumable(folder: Path, job: Job) -> Iterator[None]:
    """Raise ``RunInterrupted`` for Ctrl-C."""
    try:
        with unwrap_interruption():
            yield
    except KeyboardInterrupt:
        raise RunInterrupted(folder, job.observer.n_frames) from None


def _conclude(
    job: Job,
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
    for doubt in find_odometry_doubts(closer.history.frames):
        job.observer.on_warning(doubt)
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
    job: Job, store: MapStore, session: Session, result: SlamResult, used: Usage
) -> RunRecord:
    """Label the whole map, finish the session in it, and return the record of the run."""
    dataset, config, closer = job.dataset, job.config, job.closer
    first = closer.map.first_keyframe
    smoothed, rooms = finish_session(closer, store, session, config, warn=job.observer.on_warning)
    scenes = dataset.scenes()
    groundtruth = dataset.groundtruth()
    frame_indices = [int(result.indices[k.frame_index]) for k in result.keyframes]
    return RunRecord(
        dataset=dataset,
        closer=closer,
        seed=config.seed,
        result=result,
        candidates=of_session(store.candidates(), range(first, len(closer.map.keyframes))),
        smoothed=smoothed[first:],
        n_rooms=len(rooms),
        groundtruth=groundtruth and delayed(groundtruth, config.groundtruth_offset_s),
        groundtruth_offset_s=config.groundtruth_offset_s if groundtruth else None,
        true_scenes=None if scenes is None else [scenes[i] for i in frame_indices],
        options=job.options,
        live=job.observer.health.trajectory(result.optimized.stamps_s),
        health=job.observer.health.frames,
        usage=used,
        clock=job.clock,
    )
