"""The folder of a run: made, linked to its map, and what is written into it as text."""

from __future__ import annotations

import csv
import itertools
import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path

from slam_bof.errors import RunError
from slam_bof.geometry import read_tum, write_kitti, write_tum
from slam_bof.run.metrics import Metrics
from slam_bof.slam import of_session
from slam_bof.store import MapStore
from slam_bof.types import Candidate, Keyframe, Trajectory
from slam_bof.visualization import ReportData

__all__ = [
    "link_map",
    "logging_to",
    "make_folder",
    "naming_errors",
    "read_run",
    "write_audit_trail",
    "write_metrics",
    "write_trajectory",
]


def make_folder(out: Path) -> Path:
    """Make ``out``/<time stamp> and point ``out``/latest to it."""
    name = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
    with naming_errors(out):
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
def naming_errors(folder: Path) -> Iterator[None]:
    """Turn what the file system refuses into one line that names the place."""
    try:
        yield
    except OSError as error:
        place = error.filename or folder
        reason = error.strerror or str(error)
        raise RunError(f"{place}: cannot write the run: {reason}") from error


@contextmanager
def logging_to(path: Path) -> Iterator[None]:
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


def write_trajectory(folder: Path, name: str, trajectory: Trajectory) -> None:
    """Write a trajectory in both formats."""
    write_tum(folder / f"trajectory_{name}_tum.txt", trajectory)
    write_kitti(folder / f"trajectory_{name}_kitti.txt", trajectory)


def write_metrics(path: Path, metrics: Metrics) -> None:
    """Write ``metrics.json``."""
    path.write_text(json.dumps(metrics, indent=2) + "\n", encoding="utf-8")


def write_audit_trail(
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


def link_map(folder: Path, map_file: Path) -> None:
    """Let ``map.db`` in a run's folder be a map that is somewhere else."""
    target = os.path.relpath(map_file.resolve(), folder.resolve())
    (folder / "map.db").symlink_to(target)


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
