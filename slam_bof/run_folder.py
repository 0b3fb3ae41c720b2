"""The folder of a run: made, linked to its map, and what is written into it as text."""

from __future__ import annotations

import csv
import itertools
import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields
from datetime import datetime
from pathlib import Path

from slam_bof.errors import RunError
from slam_bof.metrics import Metrics
from slam_bof.trajectory import write_kitti, write_tum
from slam_bof.types import Candidate, Keyframe, Trajectory

__all__ = [
    "link_map",
    "logging_to",
    "make_folder",
    "naming_errors",
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
