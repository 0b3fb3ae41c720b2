"""Every plug-in that comes along, held to what is asked of anybody's."""

import numpy as np
import pytest
from conftest import CAMERA

from slam_bof import ports, testing
from slam_bof.core import registry
from slam_bof.datasets import SequenceSlice
from slam_bof.geometry import write_tum
from slam_bof.types import DepthFrame, Trajectory

ODOMETRY = {
    "genz-icp": {},
    "kiss-icp": {},
    "open3d": {},
    "open3d, frame-to-frame": {"method": "frame-to-frame"},
    "small-gicp": {},
}


@pytest.mark.parametrize("case", ODOMETRY)
def test_odometry(case):
    name, options = case.split(",")[0], ODOMETRY[case]
    testing.check_odometry(lambda: registry.build("odometry", name, options), max_error_m=0.05)


def test_recorded_odometry(tmp_path):
    depth = np.full((CAMERA.height, CAMERA.width), 1000, np.uint16)
    frames = [DepthFrame(0.1 * k, depth, CAMERA) for k in range(8)]
    _, truth = testing.example_frames(8)
    file = tmp_path / "poses.txt"
    write_tum(file, Trajectory(np.array([frame.stamp_s for frame in frames]), truth))
    testing.check_odometry(
        lambda: registry.build("odometry", "recorded", {"file": file}),
        frames=frames,
        truth=truth,
        max_error_m=1e-9,
    )


@pytest.mark.parametrize("name", registry.names("verifiers"))
def test_verifier(name):
    testing.check_verifier(lambda: registry.build("verifiers", name))


@pytest.mark.parametrize("name", registry.names("backends"))
def test_backend(name):
    testing.check_backend(lambda: registry.build("backends", name))


@pytest.mark.parametrize("name", registry.names("descriptors"))
def test_descriptor(name):
    testing.check_descriptor(lambda: registry.build("descriptors", name))


def test_dataset(write_turn, tmp_path):
    write_turn(tmp_path / "room" / "seq-01", [0.0, 0.2, 0.4])
    testing.check_dataset(registry.load("datasets", "7scenes"), tmp_path / "room" / "seq-01")


@pytest.mark.parametrize("name", registry.names("datasets"))
def test_every_data_set_plugin_is_a_format(name):
    plugin = registry.load("datasets", name)
    assert isinstance(plugin, ports.DatasetFormat)
    assert plugin.name == name


class Renamed:
    """A format that is no class of sequences: it opens those of another one."""

    name = "renamed"

    def __init__(self, format_):
        self._format = format_

    def recognises(self, path):
        return self._format.recognises(path)

    def open(self, path):
        return self._format.open(path)


def test_a_format_may_be_an_object_apart_from_its_sequences(write_turn, tmp_path):
    folder = tmp_path / "room" / "seq-01"
    write_turn(folder, [0.0, 0.2])
    format_ = Renamed(registry.load("datasets", "7scenes"))
    testing.check_dataset(format_, folder)
    sequence = format_.open(folder)
    with pytest.raises(AssertionError, match=r"all that slam_bof\.ports\.DatasetFormat has"):
        testing.check_dataset(SequenceSlice(sequence, 0, 1), folder)
