"""A package of somebody else's: installed, found by entry points, run by name; docs show it."""

import os
import re
import subprocess
import sys
from importlib import import_module

import numpy as np
import pytest
from conftest import CAMERA, ROOT, box_room_depth_mm

from slam_bof import testing
from slam_bof.geometry import se3

STRANGER = ROOT / "tests" / "stranger"
FILES = ("pyproject.toml", "stranger.py")


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the package installed, without asking the network for anything."""
    folder = tmp_path_factory.mktemp("site")
    command = [sys.executable, "-m", "pip", "install", "--no-deps", "--no-build-isolation"]
    command += ["--no-index", "--disable-pip-version-check", "-q", "--target", str(folder)]
    source = tmp_path_factory.mktemp("source")
    for name in FILES:  # a build leaves things beside its source
        (source / name).write_bytes((STRANGER / name).read_bytes())
    done = subprocess.run([*command, str(source)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """A camera that steps along a box room, in the stranger's format."""
    folder = tmp_path_factory.mktemp("walk")
    poses = [se3.pose(np.eye(3), [0.01 * k, 0.0, 0.01 * k]) for k in range(12)]
    depth = np.stack([box_room_depth_mm(CAMERA, T) for T in poses])
    camera = [CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy]
    np.savez(folder / "depth.npz", depth=depth, camera=camera)
    return folder


def slam_bof(site, *arguments):
    code = "import sys; from slam_bof.cli import main; sys.exit(main())"
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])},
        capture_output=True,
        text=True,
    )


def test_it_is_listed_and_run_by_name(site, sequence, tmp_path):
    listed = slam_bof(site, "plugins").stdout
    for name in ("npz", "still", "picky"):
        assert name in listed
    options = ["--out", tmp_path, "--set", "odometry=still", "--set", "verifier=picky"]
    done = slam_bof(site, "run", sequence, *options, "--json")
    assert done.returncode == 0, done.stderr
    assert '"n_frames": 12' in done.stdout
    assert '"dataset": "npz"' in done.stdout
    config = (tmp_path / "latest" / "config.yaml").read_text()
    assert "name: still" in config
    assert "name: picky" in config


def test_it_keeps_what_plugins_are_held_to(site, sequence, monkeypatch):
    monkeypatch.syspath_prepend(str(site))
    stranger = import_module("stranger")
    testing.check_odometry(stranger.Still)
    testing.check_dataset(stranger.NpzSequence, sequence)
    testing.check_verifier(stranger.Picky)


def test_the_documentation_shows_the_whole_of_it_in_under_40_lines():
    page = (ROOT / "docs" / "how-to" / "plugins.md").read_text(encoding="utf-8")
    shown = re.findall(r"<!-- stranger/(\S+) -->\n```\w+\n(.*?)```", page, flags=re.DOTALL)
    assert dict(shown) == {name: (STRANGER / name).read_text() for name in FILES}
    assert sum(text.count("\n") for _, text in shown) < 40


class Forgetful:
    """An odometry that is wrong in one way at a time."""

    def __init__(self, wrong):
        self.wrong = wrong
        self.n = 0

    def process(self, frame):
        T = np.eye(4)
        self.n += 1
        if self.wrong == "first":
            T[0, 3] = 1.0
        if self.wrong == "reset":
            T[0, 3] = 0.01 * (self.n - 1)
        if self.wrong == "scaled" and self.n > 1:
            T[:3, :3] *= 1.01
        if self.wrong == "float32":
            return T.astype(np.float32)
        if self.wrong == "blind" and not frame.depth.any():
            raise ValueError("nothing")
        if self.wrong == "random" and self.n > 1:
            T[0, 3] = np.random.default_rng().normal()
        if self.wrong == "frames" and frame.depth.dtype == np.uint16:
            frame.depth[0, 0] += 1
        return T

    def reset(self):
        if self.wrong != "reset":
            self.n = 0


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ("first", "the first pose must be the identity"),
        ("reset", "after reset"),
        ("scaled", "must be a rotation and a translation"),
        ("float32", r"must be a \(4, 4\) array of float64"),
        ("random", "another instance must give the same"),
        ("frames", "frames must not be changed"),
    ],
)
def test_the_check_names_what_is_wrong(wrong, message):
    with pytest.raises(AssertionError, match=message):
        testing.check_odometry(lambda: Forgetful(wrong))


def test_a_failure_on_blind_frames_shows():
    with pytest.raises(ValueError, match="nothing"):
        testing.check_odometry(lambda: Forgetful("blind"))
    testing.check_odometry(lambda: Forgetful("nothing"))
    with pytest.raises(AssertionError, match="the pose is off by"):
        testing.check_odometry(lambda: Forgetful("nothing"), max_error_m=0.001)
