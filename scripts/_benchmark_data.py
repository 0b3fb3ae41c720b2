"""Sequences of the benchmarks, recorded or made when they are first needed, and their commands."""

from __future__ import annotations

import shlex
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slam_bof.synthetic import Scene3D, make_room, spin, write_sequence

__all__ = ["RECORDED", "SCRIPTS", "Command", "Data", "UnavailableError", "execute"]

SCRIPTS = Path(__file__).resolve().parent
SLAM_BOF = [sys.executable, "-c", "from slam_bof.cli import main; main()"]
RECORDED = {
    "redkitchen": "7scenes/redkitchen/seq-01",
    "lab": "realsense/lab/seq-01",
    "office": "realsense/office/seq-01",
}
"""Folders of the recorded sequences with which models are trained, below the folder of all data."""
FOLDERS = {**RECORDED, "iphone_meeting": "iphone_meeting"}
"""Folders of all recorded sequences."""
QUICK_FRAMES = 60

Command = list[str]
"""Begins with ``slam-bof`` or ``scripts/NAME``."""


class UnavailableError(Exception):
    """A measurement cannot be made; the message says why."""


@dataclass(frozen=True)
class Data:
    """Where sequences are, and where others are made."""

    recorded: Path
    work: Path
    quick: bool

    def sequence(self, name: str) -> str:
        """Return the folder of a sequence; make it if it is synthetic."""
        if self.quick:
            return str(self._small())
        if name in FOLDERS:
            folder = self.recorded / FOLDERS[name]
            if not folder.is_dir():
                raise UnavailableError(f"{folder}: found no such sequence; --data says where")
        elif name == "twin":
            folder = self.work / "twin" / "chess-twin" / "seq-03"
            self._make(folder, "make_chess_twin", "--poses", str(self.recorded / "7scenes-poses"))
        else:
            folder = self.work / "tours" / name / "seq-01"
            self._make(folder, "make_tours", name)
        return str(folder)

    def _make(self, folder: Path, script: str, *options: str) -> None:
        if not folder.is_dir():
            execute(["scripts/" + script, "--out", str(folder.parents[1]), *options])

    def _small(self) -> Path:
        """Return a camera that turns in a room and back again."""
        folder = self.work / "room" / "seq-01"
        if not folder.is_dir():
            turn = spin(2.0, 2.0, rate_deg_s=60.0, angle_deg=QUICK_FRAMES / 2, pitch=0.3)
            poses = np.concatenate([turn, turn[::-1]])
            write_sequence(folder, Scene3D(make_room("office", 7).mesh), poses)
        return folder


def execute(command: Command) -> str:
    """Run a command; return what it prints."""
    name, *options = command
    if name == "slam-bof":
        argv = [*SLAM_BOF, *options]
    else:
        argv = [sys.executable, str(SCRIPTS / Path(name).name), *options]
    print(f"$ {shlex.join(command)}", file=sys.stderr, flush=True)
    done = subprocess.run(argv, capture_output=True, text=True, check=False)
    if done.returncode:
        lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
        raise UnavailableError(f"`{shlex.join(command)}`: {lines[-1]}")
    return done.stdout
