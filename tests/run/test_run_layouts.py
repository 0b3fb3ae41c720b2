"""A run over a layout other than 7-Scenes, from the command line to its files."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import cv2
import numpy as np
import yaml
from conftest import CAMERA, box_room_depth_mm
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.geometry import se3


def test_a_recognised_layout_is_run_and_said(tmp_path: Path) -> None:
    folder = tmp_path / "tour"
    (folder / "depth").mkdir(parents=True)
    (folder / "intrinsics.json").write_text(json.dumps({**asdict(CAMERA), "depth_scale": 5000}))
    for number in range(4):
        T = se3.exp(np.array([0, 0.03 * number, 0, 0.02 * number, 0, 0]))
        stamp_s = 100 + number / 30
        image = 5 * box_room_depth_mm(CAMERA, T)
        cv2.imwrite(str(folder / "depth" / f"{stamp_s:.6f}.png"), image)
    damaged = folder / "depth" / "100.066667.png"
    damaged.write_bytes(damaged.read_bytes()[:-100])
    out = tmp_path / "runs"
    result = CliRunner().invoke(app, ["run", str(folder), "-o", str(out), "--json"])
    assert result.exit_code == 0, result.output
    said = f"{folder}: recognised as folder: intrinsics.json, depth/100.000000.png"
    assert result.stderr.splitlines()[0] == said
    assert "frame 2 skipped: " in result.stderr
    assert "100.066667.png: found a truncated PNG file" in result.stderr
    metrics = json.loads(result.stdout)
    assert (metrics["dataset"], metrics["n_frames"]) == ("folder", 3)
    head = (out / "latest" / "run.log").read_text().splitlines()[0]
    assert head.endswith(said)
    assert yaml.safe_load((out / "latest" / "config.yaml").read_text())["dataset"]["name"] == "auto"
    poses = (out / "latest" / "trajectory_optimized_tum.txt").read_text().splitlines()
    assert [round(float(line.split()[0]), 4) for line in poses] == [100.0, 100.0333, 100.1]
