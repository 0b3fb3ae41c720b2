"""One run of the mini-SLAM over a sequence, and everything that it leaves in its folder."""

from __future__ import annotations

import csv
import itertools
import json
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from datetime import datetime
from pathlib import Path

from slam_bof import config as configs
from slam_bof import registry
from slam_bof.config import Config
from slam_bof.errors import RunError
from slam_bof.mapping import write_map
from slam_bof.metrics import Metrics, Usage, compute_metrics
from slam_bof.minislam import MiniSlam
from slam_bof.ports import Dataset, NullObserver, Observer
from slam_bof.report import ReportData, write_report
from slam_bof.scene_map import label_map
from slam_bof.slam import LoopCloser
from slam_bof.store import MapStore
from slam_bof.timing import StageClock
from slam_bof.trajectory import write_kitti, write_tum
from slam_bof.types import Candidate, Keyframe, Step, Trajectory

__all__ = ["RunResult", "run_sequence"]

LEFT_OUT = "contradicts the other loops, weighed all together at the end"
MANY_LOST = 0.1
"""Share of lost frames above which a run says so."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class RunResult:
    """Where a run's files are, and its metrics as ``metrics.json`` has them."""

    folder: Path
    metrics: Metrics


class Recorder:
    """The observer of a run: saves each keyframe at once, logs what goes wrong, passes all on."""

    def __init__(self, store: MapStore, observer: Observer) -> None:
        self._store = store
        self._observer = observer
        self._is_lost = False

    def on_start(self, n_frames: int) -> None:
        """Pass on."""
        self._observer.on_start(n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Save the keyframe, if the frame became one; log where odometry is lost and found."""
        if step.is_lost != self._is_lost:
            self._is_lost = step.is_lost
            logger.warning(
                "frame %d: odometry %s", frame_index, "lost" if step.is_lost else "found"
            )
        if step.keyframe is not None:
            self._store.add(step.keyframe, step.candidates, step.loops)
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
    observer: Observer | None = None,
    max_frames: int | None = None,
    remarks: Sequence[str] = (),
) -> RunResult:
    """Run the mini-SLAM over a sequence and write everything into a new folder under ``out``.

    ``remarks`` are lines for the head of ``run.log``.

    Raises
    ------
    RunError
        If the folder cannot be made or written.
    SlamBofError
        Whatever else the user can mend: the model, a plug-in, the data set.
    """
    clock = StageClock()
    config = configs.complete(config)
    odometry = registry.build("odometry", config.odometry.name, config.odometry.options)
    closer = LoopCloser.from_config(config, clock=clock)
    folder = _make_folder(out)
    with _naming(folder), _logging_to(folder / "run.log"):
        for remark in remarks:
            logger.info(remark)
        logger.info("%s of %s, %d frames", dataset.sequence, dataset.name, len(dataset))
        (folder / "config.yaml").write_text(configs.dump(config), encoding="utf-8")
        with MapStore.create(folder / "map.db") as store:
            recorder = Recorder(store, observer or NullObserver())
            store.set_parameters(_parameters(dataset, config))
            started = Usage.now()
            slam = MiniSlam(odometry, closer, observer=recorder, clock=clock)
            result = slam.run(dataset, max_frames=max_frames)
            _write_trajectory(folder, "odometry", result.odometry)
            _write_trajectory(folder, "optimized", result.optimized)
            used = Usage.now() - started
            if closer.n_frames_lost > MANY_LOST * len(result.indices):
                recorder.on_warning(
                    f"{closer.n_frames_lost} of {len(result.indices)} frames are lost: too little "
                    "depth, or too little in common with what was seen before"
                )
            T_map_camera = closer.backend.poses()
            store.set_map_poses(T_map_camera)
            store.leave_out(closer.loops_left_out, LEFT_OUT)
            smoothed, regions = label_map(
                closer.keyframes, T_map_camera, config.labels, config.regions, parts=closer.parts
            )
            store.set_scenes(smoothed, regions)
            candidates = store.candidates()
        groundtruth = dataset.groundtruth()
        keyframe_frames = [int(result.indices[k.frame_index]) for k in closer.keyframes]
        scenes = dataset.scenes()
        true_scenes = None if scenes is None else [scenes[i] for i in keyframe_frames]
        metrics = compute_metrics(
            dataset_name=dataset.name,
            sequence=dataset.sequence,
            result=result,
            closer=closer,
            candidates=candidates,
            groundtruth=groundtruth,
            true_scenes=true_scenes,
            smoothed=smoothed,
            n_regions=len(regions),
            usage=used,
            clock=clock,
            seed=config.seed,
        )
        _write_json(folder / "metrics.json", metrics)
        if groundtruth is not None:
            _write_trajectory(folder, "groundtruth", groundtruth)
        closer.backend.write_g2o(folder / "pose_graph.g2o")
        _write_audit_trail(folder / "loops.csv", candidates, closer.keyframes)
        write_map(folder / "map.ply", dataset, keyframe_frames, T_map_camera)
        write_report(
            folder / "report.html",
            ReportData(
                metrics=metrics,
                odometry=result.odometry,
                optimized=result.optimized,
                groundtruth=groundtruth,
                keyframes=[
                    replace(keyframe, smoothed=scene)
                    for keyframe, scene in zip(closer.keyframes, smoothed, strict=True)
                ],
                loops=closer.loops,
                candidates=candidates,
                true_scenes=true_scenes,
            ),
        )
        logger.info("done: %d keyframes, %s loops", len(closer.keyframes), metrics["n_loops"])
    return RunResult(folder, metrics)


def _make_folder(out: Path) -> Path:
    """Make ``out``/<time stamp> and point ``out``/latest to it."""
    name = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    with _naming(out):
        out.mkdir(parents=True, exist_ok=True)
        for attempt in itertools.count():
            folder = out / (f"{name}_{attempt}" if attempt else name)
            if not folder.exists():
                break
        folder.mkdir()
        link = out / ".latest"
        link.unlink(missing_ok=True)
        link.symlink_to(folder.name, target_is_directory=True)
        link.replace(out / "latest")
    return folder


@contextmanager
def _naming(folder: Path) -> Iterator[None]:
    """Turn what the file system refuses into one line that names the place."""
    try:
        yield
    except OSError as error:
        place = error.filename or folder
        reason = error.strerror or str(error)
        raise RunError(f"{place}: cannot write the run: {reason}") from error


@contextmanager
def _logging_to(path: Path) -> Iterator[None]:
    """Send the package's log to a file while the block runs."""
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    package = logging.getLogger("slam_bof")
    level = package.level
    package.addHandler(handler)
    package.setLevel(logging.INFO)
    try:
        yield
    finally:
        package.removeHandler(handler)
        package.setLevel(level)
        handler.close()


def _parameters(dataset: Dataset, config: Config) -> dict[str, str]:
    return {
        "dataset": dataset.name,
        "sequence": dataset.sequence,
        "config": configs.dump(config),
        "seed": str(config.seed),
    }


def _write_trajectory(folder: Path, name: str, trajectory: Trajectory) -> None:
    write_tum(folder / f"trajectory_{name}_tum.txt", trajectory)
    write_kitti(folder / f"trajectory_{name}_kitti.txt", trajectory)


def _write_json(path: Path, metrics: Metrics) -> None:
    path.write_text(json.dumps(metrics, indent=2) + "\n", encoding="utf-8")


def _write_audit_trail(
    path: Path, candidates: Sequence[Candidate], keyframes: Sequence[Keyframe]
) -> None:
    """Write a line for each pair of keyframes considered; an empty field is a figure not made."""
    names = [field.name for field in fields(Candidate)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["query_stamp_s", "match_stamp_s", *names])
        for candidate in candidates:
            values = [getattr(candidate, name) for name in names]
            writer.writerow(
                [
                    keyframes[candidate.query_id].stamp_s,
                    keyframes[candidate.match_id].stamp_s,
                    *("" if value != value else value for value in values),
                ]
            )
