"""Folders of runs, which the report and ``run --resume`` read."""

from __future__ import annotations

import dataclasses
import json
import random
import shutil
from pathlib import Path

import numpy as np
from _layouts import write_folder

from fuzzing.cases import Reader, expect, quiet, turn
from fuzzing.maps import CONFIG, forge_map
from fuzzing.mutations import mutate_bytes, mutate_json, mutate_text
from slam_bof.core import open_dataset
from slam_bof.maps import MapLocalizer
from slam_bof.run import read_run, run_sequence
from slam_bof.types import Trajectory
from slam_bof.visualization import write_report

__all__ = ["READERS"]


def prepare_run(place: Path) -> None:
    """Run the mini-SLAM over a few frames."""
    frames, poses = turn()
    frames = [dataclasses.replace(frame, stamp_s=k / 30) for k, frame in enumerate(frames)]
    truth = Trajectory(np.arange(len(frames)) / 30, np.array(poses))
    write_folder(place / "turn", frames, truth)
    source = json.dumps({"path": str(place / "turn"), "frames": "0:24"})
    result = run_sequence(open_dataset(place / "turn"), CONFIG, place / "runs", source=source)
    shutil.move(result.folder, place / "run")
    shutil.copy(place / "run" / "map.db", place / "map.db")


def mutate_run(place: Path, case: Path, rng: random.Random) -> None:
    """Change one file of a run, or take it away."""
    run = case / "run"
    shutil.copytree(place / "run", run)
    names = sorted(file.name for file in run.iterdir() if file.is_file())
    file = run / rng.choice((*names, "metrics.json", "metrics.json", "health.csv"))
    if file.name == "map.db":
        file.unlink()
        forge_map(place, run, rng)
    elif file.name == "metrics.json" and rng.random() < 0.6:
        file.write_text(json.dumps(mutate_json(json.loads(file.read_text()), rng)))
    elif rng.random() < 0.1:
        file.unlink()
    elif file.suffix in (".json", ".csv", ".txt", ".yaml"):
        file.write_bytes(mutate_text(file.read_text(), rng).encode(errors="surrogateescape"))
    else:
        file.write_bytes(mutate_bytes(file.read_bytes(), rng))


def read_run_folder(place: Path, case: Path) -> None:
    """Make the report of a run, and localise in its map."""
    quiet(lambda: MapLocalizer.open(case / "run"))
    report = case / "report.html"
    write_report(report, read_run(case / "run"))
    expect(report.stat().st_size < 20_000_000, "a report of 20 MB")


READERS = {"run": Reader(0.2, prepare_run, mutate_run, read_run_folder)}
