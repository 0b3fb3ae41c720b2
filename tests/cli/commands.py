"""Commands as a user types them, and a sequence and a model to give them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
from conftest import CAMERA, box_room_depth_mm
from typer.testing import CliRunner, Result

from slam_bof.bof import PlaceParams
from slam_bof.cli import app
from slam_bof.geometry import se3
from slam_bof.scenes import TrainingFrame, model, train_model
from slam_bof.types import DepthFrame

N_FRAMES = 6


def slam_bof(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def refusal(*arguments: object) -> str:
    """What a command says that the user's mistake stopped: one line and exit code 1."""
    result = slam_bof(*arguments)
    assert result.exit_code == 1, result.output
    assert result.stdout == ""
    *_, last = result.stderr.splitlines()
    assert last.startswith("error: ")
    return last


def in_process(*arguments: object, **kwargs: object) -> subprocess.Popen[str]:
    code = "from slam_bof.cli import main; main()"
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **kwargs,
    )


def write_box_sequence(scenes: Path) -> Path:
    """Write a sequence in 7-Scenes layout: a slow turn in a box room."""
    folder = scenes / "box" / "seq-01"
    folder.mkdir(parents=True)
    for number in range(N_FRAMES):
        T_world_camera = se3.exp(np.array([0, 0.05 * number, 0, 0.02 * number, 0, 0]))
        depth = box_room_depth_mm(CAMERA, T_world_camera)
        cv2.imwrite(str(folder / f"frame-{number:06d}.depth.png"), depth)
        np.savetxt(folder / f"frame-{number:06d}.pose.txt", T_world_camera)
    rows = "".join(f"{number},box\n" for number in range(N_FRAMES))
    (folder / "scenes.csv").write_text(f"frame,scene\n{rows}")
    return folder


def write_tiny_model(path: Path) -> Path:
    """Write a model that has seen a few views of a box room."""
    frames = []
    for i in range(6):
        T = se3.exp(np.array([0.1 * i, 0.4 * i, 0, 0.1 * i, 0, 0]))
        frames.append(TrainingFrame(DepthFrame(float(i), box_room_depth_mm(CAMERA, T), CAMERA)))
    model.save(train_model(frames, PlaceParams(), n_words=8, trained_on="a box room"), path)
    return path
