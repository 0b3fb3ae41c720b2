"""A run that was interrupted and resumed leaves what an uninterrupted one leaves."""

import csv
import shutil

import numpy as np
import pytest

from slam_bof.geometry import read_tum
from slam_bof.ports import NullObserver
from slam_bof.run import RunInterrupted, resume_sequence, run_sequence
from slam_bof.slam import preset
from slam_bof.slam.config import override
from slam_bof.synthetic.degenerate import DegenerateCase, render_case

CONFIG = override(preset("indoor"), ["keyframes.max_gap=4", "model=synthetic"])
AT = 23
"""Frame at which the run is interrupted."""


class Wall:
    """A camera that slides past a bare wall, and is covered for two frames."""

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


@pytest.fixture(scope="module")
def interrupted(wall, tmp_path_factory):
    with pytest.raises(RunInterrupted) as caught:
        run_sequence(wall, CONFIG, tmp_path_factory.mktemp("half"), observer=Interrupt())
    assert caught.value.n_frames == AT + 1
    return caught.value.folder


def health(folder):
    with (folder / "health.csv").open() as file:
        return list(csv.DictReader(file))


def test_a_resumed_run_leaves_what_an_uninterrupted_one_leaves(wall, whole, interrupted, tmp_path):
    folder = shutil.copytree(interrupted, tmp_path / "half")
    result = resume_sequence(wall, folder / "map.db", tmp_path)
    assert result.folder == folder
    assert 0 < result.metrics["n_frames_resumed"] <= AT
    frames = health(folder)
    assert {row["health"] for row in frames[: result.metrics["n_frames_resumed"]]} > {"degenerate"}
    for name in ("health.csv", "loops.csv"):
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
