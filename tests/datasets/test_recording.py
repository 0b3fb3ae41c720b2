"""Recording from a camera whose SDK is played by a module of our own, and reading it back."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from slam_bof.cli import app
from slam_bof.core import registry

SDK = '''
"""What slam_bof asks of pyrealsense2, and nothing else of it."""
import json, os, time
from enum import Enum
import numpy as np

PLAY = json.loads(os.environ.get("FAKE_REALSENSE", "{}"))
stream = Enum("stream", "depth color")
format = Enum("format", "z16 rgb8")

class config:
    def __init__(self): self.streams, self.serial = {}, None
    def enable_device(self, serial): self.serial = serial
    def enable_stream(self, kind, width, height, coding, fps):
        self.streams[kind] = (width, height, coding, fps)

class _Frame:
    def __init__(self, stamp_ms, number, data):
        self.stamp_ms, self.number, self.data = stamp_ms, number, data
    def get_timestamp(self): return self.stamp_ms
    def get_frame_number(self): return self.number
    def get_data(self): return self.data

class _Frames:
    def __init__(self, depth, color): self.depth, self.color = depth, color
    def get_depth_frame(self): return self.depth
    def get_color_frame(self): return self.color

class align:
    def __init__(self, to): assert to is stream.depth
    def process(self, frames): return frames

class _Object:
    def __init__(self, **fields): self.__dict__.update(fields)

class pipeline:
    def start(self, config):
        if PLAY.get("absent") or config.serial == "none":
            raise RuntimeError("No device connected")
        self.width, self.height, coding, fps = config.streams[stream.depth]
        assert coding is format.z16
        if fps > 90:
            raise RuntimeError("Couldn't resolve requests")
        self.with_color = stream.color in config.streams
        self.taken = 0
        camera = _Object(width=self.width, height=self.height, fx=30.5, fy=31.5, ppx=16.5, ppy=12.5)
        sensor = _Object(get_depth_scale=lambda: PLAY.get("scale", 0.0010000000474974513))
        video = _Object(get_intrinsics=lambda: camera)
        depth = _Object(as_video_stream_profile=lambda: video)
        return _Object(
            get_device=lambda: _Object(first_depth_sensor=lambda: sensor),
            get_stream=lambda kind: depth,
        )
    def wait_for_frames(self, timeout_ms):
        time.sleep(PLAY.get("wait_s", 0))
        if self.taken == PLAY.get("interrupt_at"):
            raise KeyboardInterrupt
        if self.taken == PLAY.get("silent_at"):
            raise RuntimeError("Frame didn't arrive within 5000")
        number = self.taken
        self.taken += 1
        for skipped in PLAY.get("skips", []):
            number += self.taken > skipped
        stamp_ms = 1700000000000.0 + 1000 * number / 30
        if number in PLAY.get("repeats", []):
            stamp_ms -= 40
        data = np.full((self.height, self.width), 1000 + number, np.uint16)
        color = None
        if self.with_color:
            image = np.full((self.height, self.width, 3), (200, 0, 0), np.uint8)
            color = _Frame(stamp_ms, number, image)
        return _Frames(_Frame(stamp_ms, number, data), color)
    def stop(self): pass
'''


@pytest.fixture
def sdk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "sdk"
    folder.mkdir()
    (folder / "pyrealsense2.py").write_text(SDK)
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.delitem(sys.modules, "pyrealsense2", raising=False)
    monkeypatch.delenv("FAKE_REALSENSE", raising=False)
    return folder


def play(monkeypatch: pytest.MonkeyPatch, **what: object) -> None:
    monkeypatch.setenv("FAKE_REALSENSE", json.dumps(what))


def record(folder: Path, *arguments: object) -> Result:
    size = ("--width", 32, "--height", 24)
    return CliRunner().invoke(app, ["record", *map(str, (folder, *size, *arguments))])


@pytest.mark.usefixtures("sdk")
def test_a_recording_is_a_data_set(tmp_path: Path) -> None:
    folder = tmp_path / "lab" / "first"
    result = record(folder, "--frames", 5, "--json", "--quiet")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout) == {"folder": str(folder), "n_frames": 5, "n_dropped": 0}
    dataset = registry.open_dataset(folder)
    assert (dataset.name, dataset.sequence, len(dataset)) == ("folder", "lab/first", 5)
    camera = dataset.intrinsics
    assert (camera.width, camera.height) == (32, 24)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (30.5, 31.5, 16.5, 12.5)
    for number in range(5):
        frame = dataset.frame(number)
        assert frame.stamp_s == pytest.approx(1.7e9 + number / 30, abs=1e-6)
        assert frame.depth.dtype == np.uint16
        assert (frame.depth == 1000 + number).all()
    assert dataset.color(0) is None
    assert sorted(path.name for path in folder.iterdir()) == ["depth", "intrinsics.json"]


@pytest.mark.usefixtures("sdk")
def test_colour_on_demand(tmp_path: Path) -> None:
    assert record(tmp_path / "a", "--frames", 2, "--color").exit_code == 0
    color = registry.open_dataset(tmp_path / "a").color(1)
    assert color is not None
    assert color[5, 5, 0] > 190
    assert color[5, 5, 2] < 10


@pytest.mark.usefixtures("sdk")
def test_other_units_are_written_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play(monkeypatch, scale=0.0002500000118743628)
    assert record(tmp_path / "a", "--frames", 1).exit_code == 0
    assert json.loads((tmp_path / "a" / "intrinsics.json").read_text())["depth_scale"] == 4000.0
    assert (registry.open_dataset(tmp_path / "a").frame(0).depth == np.float32(0.25)).all()


@pytest.mark.usefixtures("sdk")
def test_repeated_and_missing_frames_are_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    play(monkeypatch, repeats=[2], skips=[4, 4])
    result = record(tmp_path / "a", "--frames", 5)
    assert f"{tmp_path / 'a'}: 5 frames" in result.stdout
    assert "2 frames are missing: they arrived faster" in result.stderr
    dataset = registry.open_dataset(tmp_path / "a")
    assert [int(dataset.frame(i).depth[0, 0]) - 1000 for i in range(5)] == [0, 1, 3, 6, 7]


@pytest.mark.usefixtures("sdk")
def test_ctrl_c_ends_a_recording_as_usual(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play(monkeypatch, interrupt_at=3)
    result = record(tmp_path / "a")
    assert result.exit_code == 0
    assert f"Next: slam-bof run {tmp_path / 'a'}" in result.stdout
    assert len(registry.open_dataset(tmp_path / "a")) == 3


@pytest.mark.usefixtures("sdk")
def test_a_duration_ends_a_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    play(monkeypatch, wait_s=0.02)
    assert record(tmp_path / "a", "--duration", 0.1).exit_code == 0
    assert 1 <= len(registry.open_dataset(tmp_path / "a")) <= 6


def test_a_killed_recording_is_a_recording(sdk: Path, tmp_path: Path) -> None:
    folder = tmp_path / "a"
    code = "from slam_bof.cli import main; main()"
    size = ("--width", "320", "--height", "240")
    path = os.pathsep.join([str(sdk), os.environ.get("PYTHONPATH", "")])
    with subprocess.Popen(
        [sys.executable, "-c", code, "record", str(folder), *size, "--quiet"],
        env={**os.environ, "PYTHONPATH": path},
    ) as recorder:
        deadline_s = time.monotonic() + 20
        while len(list(folder.glob("depth/[0-9]*.png"))) < 20 and time.monotonic() < deadline_s:
            time.sleep(0.005)
        recorder.send_signal(signal.SIGKILL)
    dataset = registry.open_dataset(folder)
    assert len(dataset) >= 20
    for number in range(len(dataset)):
        assert (dataset.frame(number).depth == 1000 + number).all()


@pytest.mark.usefixtures("sdk")
@pytest.mark.parametrize(
    ("what", "arguments", "message"),
    [
        ({"absent": True}, [], "RealSense: found trouble (No device connected), expected a camera"),
        ({}, ["--serial", "none"], "found trouble (No device connected)"),
        ({}, ["--fps", 300], "expected a camera with depth of 32x24 pixels at 300 Hz"),
        ({"silent_at": 2}, [], "found trouble (Frame didn't arrive within 5000)"),
    ],
)
def test_trouble_with_the_camera_is_one_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    what: dict[str, object],
    arguments: list[object],
    message: str,
) -> None:
    play(monkeypatch, **what)
    result = record(tmp_path / "a", *arguments)
    assert result.exit_code == 1
    *_, last = result.stderr.splitlines()
    assert last.startswith("error: RealSense: ")
    assert message in last


@pytest.mark.usefixtures("sdk")
def test_a_folder_with_files_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("keep")
    result = record(tmp_path, "--frames", 1)
    assert result.exit_code == 1
    assert f"{tmp_path}: found something there already, expected a new folder" in result.stderr
    result = record(tmp_path / "mine.txt", "--frames", 1)
    assert "mine.txt: found something there already" in result.stderr


def test_a_missing_sdk_names_the_pip_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    result = record(tmp_path / "a")
    assert result.exit_code == 1
    assert "needs pyrealsense2, which is not installed; try: pip install slam-bof[realsense]" in (
        result.stderr
    )
    assert not (tmp_path / "a").exists()
