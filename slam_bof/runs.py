"""What a run has left in its folder, read back."""

from __future__ import annotations

import json
from pathlib import Path

from slam_bof.errors import RunError
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
        return ReportData(
            metrics=figures,
            odometry=read_tum(folder / "trajectory_odometry_tum.txt"),
            optimized=read_tum(folder / "trajectory_optimized_tum.txt"),
            groundtruth=read_tum(groundtruth) if groundtruth.is_file() else None,
            keyframes=store.keyframes(),
            loops=store.loops(),
            candidates=store.candidates(),
        )
