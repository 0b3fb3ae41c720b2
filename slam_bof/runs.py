"""What a run has left in its folder, read back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from slam_bof.errors import RunError
from slam_bof.minislam import of_session
from slam_bof.report import ReportData
from slam_bof.store import MapStore
from slam_bof.trajectory import read_tum

__all__ = ["read_run"]


def read_run(folder: Path) -> ReportData:
    """Read a finished run as its report shows it, but for the true labels, which it does not keep.

    Raises
    ------
    RunError
        If the folder is not that of a finished run.
    SlamBofError
        If one of its files is damaged.
    """
    metrics = folder / "metrics.json"
    groundtruth = folder / "trajectory_groundtruth_tum.txt"
    try:
        figures = json.loads(metrics.read_text(encoding="utf-8"))
    except FileNotFoundError:
        found = "no metrics.json there" if folder.is_dir() else "no such folder"
        raise RunError(f"{folder}: found {found}, expected the folder of a finished run") from None
    except (OSError, ValueError) as error:
        raise RunError(f"{metrics}: found {error}, expected the metrics of a run") from error
    with MapStore.open(folder / "map.db") as store:
        # The map may be of several sessions, of which the run was one.
        own = [k for k in store.keyframes() if k.session == figures.get("session", 0)]
        ids = range(own[0].id, own[-1].id + 1) if own else range(0)
        return ReportData(
            metrics=figures,
            odometry=read_tum(folder / "trajectory_odometry_tum.txt"),
            optimized=read_tum(folder / "trajectory_optimized_tum.txt"),
            groundtruth=read_tum(groundtruth) if groundtruth.is_file() else None,
            keyframes=[replace(keyframe, id=keyframe.id - ids.start) for keyframe in own],
            loops=of_session(store.loops(), ids),
            candidates=of_session(store.candidates(), ids),
        )
