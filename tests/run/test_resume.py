"""A run that was interrupted and resumed leaves what an uninterrupted one leaves."""

import csv
import shutil
import sqlite3

import numpy as np
import pytest

from slam_bof.errors import DatasetError
from slam_bof.geometry import read_tum
from slam_bof.ports import NullObserver
from slam_bof.run import RunInterrupted, resume_sequence, run_sequence
from slam_bof.slam import mini_slam, preset
from slam_bof.slam.config import override
from slam_bof.synthetic.degenerate import DegenerateCase, render_case
from slam_bof_plugins.odometry_kiss_icp import KissIcpOdometry

CONFIG = override(preset("indoor"), ["keyframes.max_gap=4", "model=synthetic"])
AT = 23
"""Frame at which the run is interrupted."""
BROKEN = 5
"""Frame that cannot be read."""
SAVE_EVERY = 2
"""Keyframes from one saved state of the odometry to the next."""


class Wall:
    """A camera that slides past a bare wall, is covered for two frames, and spoils one."""

    name = "wall"
    sequence = "wall/past"

    def __init__(self):
        frames = list(render_case(DegenerateCase("wall", sensor="kinect", rate_hz=8.0)))
        for frame in frames[10:12]:
            frame.depth[:] = 0
        self._frames = frames
        self.intrinsics = frames[0].intrinsics

    def __len__(self):
        return len(self._frames)

    def frame(self, index):
        if index == BROKEN:
            raise DatasetError("frame-5.png: found no image")
        return self._frames[index]

    def color(self, index): ...

    def gray(self, index): ...

    def groundtruth(self): ...

    def scenes(self): ...


class Interrupt(NullObserver):
    def on_step(self, frame_index, step):
        if frame_index == AT:
            raise KeyboardInterrupt


@pytest.fixture(scope="module")
def wall():
    return Wall()


@pytest.fixture(scope="module")
def whole(wall, tmp_path_factory):
    """The folder of the uninterrupted run."""
    return run_sequence(wall, CONFIG, tmp_path_factory.mktemp("whole")).folder


@pytest.fixture(autouse=True, scope="module")
def often():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mini_slam, "SAVE_EVERY", SAVE_EVERY)
        yield


@pytest.fixture(scope="module")
def interrupted(wall, tmp_path_factory):
    with pytest.raises(RunInterrupted) as caught:
        run_sequence(wall, CONFIG, tmp_path_factory.mktemp("half"), observer=Interrupt())
    assert caught.value.n_frames == AT  # one of those up to AT could not be read
    return caught.value.folder


def health(folder):
    with (folder / "health.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.fixture
def count_processed(monkeypatch):
    """Return a function that counts the frames that the odometry has processed."""
    process, counts = KissIcpOdometry.process, []

    def counting(odometry, frame):
        counts.append(1)
        return process(odometry, frame)

    monkeypatch.setattr(KissIcpOdometry, "process", counting)
    return lambda: len(counts)


@pytest.mark.parametrize(
    "forget",
    [
        "",
        "DELETE FROM odometry",
        "DELETE FROM odometry WHERE name = 'skipped'",
        "DELETE FROM odometry WHERE name = 'state/threshold'",
    ],
)
def test_a_resumed_run_leaves_what_an_uninterrupted_one_leaves(
    wall, whole, interrupted, forget, count_processed, tmp_path
):
    folder = shutil.copytree(interrupted, tmp_path / "half")
    with sqlite3.connect(folder / "map.db") as db:
        db.execute(forget)
    db.close()
    result = resume_sequence(wall, folder / "map.db", tmp_path)
    assert result.folder == folder
    n_resumed, n_repeated = (result.metrics[f"n_frames_{kind}"] for kind in ("resumed", "repeated"))
    assert 10 < n_resumed <= AT
    assert n_repeated == n_resumed if forget else n_repeated <= 4 * SAVE_EVERY
    assert count_processed() == len(wall) - 1 - n_resumed + n_repeated
    log = (folder / "run.log").read_text()
    assert f"resumed after {n_resumed} frames; the odometry ran again over {n_repeated}" in log
    assert ("cannot be used" in log) == ("threshold" in forget)
    frames = health(folder)
    assert {row["health"] for row in frames[:n_resumed]} > {"degenerate"}
    for name in ("health.csv", "loops.csv", "trajectory_odometry_tum.txt"):
        assert (folder / name).read_bytes() == (whole / name).read_bytes(), name
    found, expected = (read_tum(f / "trajectory_optimized_tum.txt") for f in (folder, whole))
    np.testing.assert_allclose(found.poses, expected.poses, atol=1e-9)


def test_without_the_health_of_earlier_frames_a_run_is_resumed_all_the_same(
    wall, whole, interrupted, tmp_path
):
    folder = shutil.copytree(interrupted, tmp_path / "half")
    (folder / "health.csv").write_bytes(b"health,n_open\ntracked,0\ntra")
    n_resumed = resume_sequence(wall, folder / "map.db", tmp_path).metrics["n_frames_resumed"]
    found, expected = health(folder), health(whole)
    assert found[n_resumed:] == expected[n_resumed:]
    assert {row["n_open"] for row in found[:n_resumed]} == {"0"}
