"""The files that a run leaves in its folder."""

from __future__ import annotations

import csv
import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import keep_going
from slam_bof.geometry import write_kitti, write_tum
from slam_bof.maps import write_sequence_cloud
from slam_bof.run.folder import rerun_command
from slam_bof.run.health import write_health
from slam_bof.run.logging_observer import read_warnings
from slam_bof.run.metrics import Metrics
from slam_bof.run.pictures import picture_pairs
from slam_bof.run.plan import read_plans
from slam_bof.run.record import RunRecord
from slam_bof.store import MapStore, largest_component
from slam_bof.types import Candidate, Keyframe, Trajectory
from slam_bof.visualization import ReportData, write_report

__all__ = ["write_outputs", "write_trajectory"]

logger = logging.getLogger(__name__)


def write_outputs(
    folder: Path,
    record: RunRecord,
    metrics: Metrics,
    store: MapStore,
    warn: Callable[[str], None],
) -> None:
    """Write everything but the two estimated trajectories and ``map.db``, which come first.

    ``store`` is the map. ``warn`` is called with a message for a file that cannot be made.
    """
    result = record.result
    frame_indices = [int(result.indices[k.frame_index]) for k in result.keyframes]
    text = json.dumps(metrics, indent=2) + "\n"
    (folder / "metrics.json").write_text(text, encoding="utf-8")
    if record.groundtruth is not None:
        write_trajectory(folder, "groundtruth", record.groundtruth)
    components = record.closer.map.components[record.closer.map.first_keyframe :]
    write_health(
        folder / "health.csv",
        result.optimized.stamps_s,
        record.health,
        [k.frame_index for k in result.keyframes],
        components,
    )
    _write_audit_trail(folder / "loops.csv", record.candidates, result.keyframes, components)
    with keep_going("pose_graph.g2o", warn):
        record.closer.map.graph.backend.write_g2o(folder / "pose_graph.g2o")
    with keep_going("map.ply", warn):
        inside = components == largest_component(components)
        shown = [index for index, is_shown in zip(frame_indices, inside, strict=True) if is_shown]
        write_sequence_cloud(
            folder / "map.ply",
            record.dataset,
            shown,
            result.T_map_camera[inside],
            with_color=record.options.with_color,
            z_up=record.options.z_up,
        )
    with keep_going("report.html", warn):
        write_report(
            folder / "report.html", _report_data(folder, record, metrics, store, components)
        )


def write_trajectory(folder: Path, name: str, trajectory: Trajectory) -> None:
    """Write a trajectory in the formats of TUM and, if all poses are known, of KITTI.

    In KITTI's format the number of a line is that of its frame, so that an unknown pose can
    neither be left out nor written: tools such as evo do not read NaN.
    """
    write_tum(folder / f"trajectory_{name}_tum.txt", trajectory)
    unknown = np.isnan(trajectory.poses).any(axis=(1, 2))
    kitti = folder / f"trajectory_{name}_kitti.txt"
    if unknown.any():
        logger.info("%s: not written, %d poses are unknown", kitti.name, unknown.sum())
    else:
        write_kitti(kitti, trajectory)


def _write_audit_trail(
    path: Path,
    candidates: Sequence[Candidate],
    keyframes: Sequence[Keyframe],
    components: NDArray[np.intp],
) -> None:
    """Write one row for each pair considered; a field is empty where it was not measured.

    ``component`` is that of the query in the finished map, among ``components`` (K,).
    """
    names = [field.name for field in fields(Candidate)]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(["query_stamp_s", "match_stamp_s", *names, "component"])
        for candidate in candidates:
            values = [getattr(candidate, name) for name in names]
            writer.writerow(
                [
                    keyframes[candidate.query_id].stamp_s,
                    keyframes[candidate.match_id].stamp_s,
                    *("" if value != value else value for value in values),
                    components[candidate.query_id],
                ]
            )


def _report_data(
    folder: Path,
    record: RunRecord,
    metrics: Metrics,
    store: MapStore,
    components: NDArray[np.intp],
) -> ReportData:
    result = record.result
    return ReportData(
        metrics=metrics,
        odometry=result.odometry,
        optimized=result.optimized,
        groundtruth=record.groundtruth,
        keyframes=[
            replace(keyframe, smoothed=scene)
            for keyframe, scene in zip(result.keyframes, record.smoothed, strict=True)
        ],
        components=components.tolist(),
        loops=result.loops,
        candidates=record.candidates,
        true_scenes=record.true_scenes,
        plans=read_plans(store),
        pairs=picture_pairs(store, record.candidates, record.closer.map.session),
        health=record.health,
        warnings=read_warnings(folder / "run.log"),
        command=rerun_command(folder, store),
        configuration=(folder / "config.yaml").read_text(encoding="utf-8"),
    )
