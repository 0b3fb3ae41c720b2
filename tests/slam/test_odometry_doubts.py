"""Odometries whose poses are not what they are taken for."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import Look
from typer.testing import CliRunner

from slam_bof.cli import app
from slam_bof.core import registry
from slam_bof.errors import FrameWarning
from slam_bof.geometry import AXES, se3, write_tum
from slam_bof.slam import LoopCloser, find_odometry_doubts
from slam_bof.types import LOST, Array, DepthFrame, FramePose, Pose, Trajectory

N_FRAMES = 300
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


def walk(noise: float = 0.0, seed: int = 0) -> Array:
    """Return poses (N, 4, 4) of a camera that looks around while it moves."""
    rng = np.random.default_rng(seed)
    phases, t = rng.uniform(0, 6, 6), np.arange(N_FRAMES) / 30
    tangents = np.sin(np.outer(t, rng.uniform(0.5, 2.0, 6)) + phases) * [0.3, 0.8, 0.2, 1, 0.3, 1]
    poses = [se3.exp(tangents[0])]
    for a, b in itertools.pairwise(tangents):
        step = se3.inverse(se3.exp(a)) @ se3.exp(b)
        poses.append(poses[-1] @ step @ se3.exp(noise * rng.standard_normal(6)))
    return np.array(poses)


def history(tracked: Array, by_odometry: Array, segment: int = 0) -> list[FramePose]:
    pairs = zip(by_odometry, tracked, strict=True)
    return [FramePose(k / 30, raw, T, segment) for k, (raw, T) in enumerate(pairs)]


def with_axes(poses: Array, name: str) -> Array:
    return poses @ se3.pose(AXES[name].T, [0.1, 0.05, 0.3])


def test_an_odometry_that_drifts_is_in_no_doubt() -> None:
    assert find_odometry_doubts(history(walk(), walk())) == []
    assert find_odometry_doubts(history(walk(0.01), walk(seed=0))) == []


@pytest.mark.parametrize(
    ("misread", "said"),
    [
        (lambda T: with_axes(T, "ros"), "it would fit as axes x forward, y left, z up"),
        (lambda T: with_axes(T, "opengl"), "it would fit as axes x right, y up, z back"),
        (se3.inverse, "it would fit as poses from the world to the camera"),
        (lambda T: T[0] @ se3.inverse(T), "it would fit as poses from the world to the camera"),
        (
            lambda T: MIRROR @ T @ MIRROR,
            "it would fit as axes that are turned by 180 degrees, or mirrored",
        ),
        (lambda T: walk(seed=5), "no other axes fit either"),
    ],
)
def test_another_convention_is_named(misread: Callable[[Array], Array], said: str) -> None:
    (doubt,) = find_odometry_doubts(history(walk(0.003), misread(walk())))
    assert said in doubt


def test_another_unit_and_poses_that_stand_still_are_named() -> None:
    millimetres = walk()
    millimetres[:, :3, 3] *= 1000.0
    (doubt,) = find_odometry_doubts(history(walk(), millimetres))
    assert "odometry moves 1e+03 times as far as depth shows" in doubt
    still = np.tile(np.eye(4), (N_FRAMES, 1, 1))
    (doubt,) = find_odometry_doubts(history(walk(), still))
    assert doubt == "odometry hardly moves while depth shows that the camera does"


def test_little_motion_and_lost_frames_tell_nothing() -> None:
    inverse = se3.inverse(walk())
    assert find_odometry_doubts([]) == []
    assert find_odometry_doubts(history(walk()[:20], inverse[:20])) == []
    assert find_odometry_doubts(history(walk(), inverse, segment=LOST)) == []


def test_the_commands_name_it(tmp_path: Path, write_turn: Callable[..., None]) -> None:
    folder, poses = tmp_path / "turn", tmp_path / "poses.txt"
    write_turn(folder, list(np.arange(0.0, 6.2, 0.1)), [0.2 * np.sin(k / 3) for k in range(62)])
    truth = registry.open_dataset(folder).groundtruth()
    assert truth is not None
    write_tum(poses, Trajectory(truth.stamps_s, with_axes(truth.poses, "ros")))
    said = "axes x forward, y left, z up"
    check = CliRunner().invoke(app, ["check", str(folder), "--odometry", str(poses), "-q"])
    assert check.exit_code == 1
    assert check.stderr.startswith(f"error: {poses}: odometry turns otherwise than depth shows")
    assert said in check.stderr
    odometry = f"odometry={{name: recorded, options: {{file: {poses}}}}}"
    run = CliRunner().invoke(
        app, ["run", str(folder), "--out", str(tmp_path / "runs"), "--set", odometry]
    )
    assert run.exit_code == 0, run.output
    assert "warning: odometry turns otherwise than depth shows" in run.stderr


def test_who_calls_finish_is_warned(turned_walk: list[tuple[DepthFrame, Pose]]) -> None:
    closer = LoopCloser.from_preset()
    for frame, T_odom_base in turned_walk:
        closer.process(frame, T_odom_base)
    with pytest.warns(FrameWarning, match="it would fit as axes x forward") as said:
        closer.finish()
    assert said[0].filename == __file__


@pytest.fixture
def turned_walk(look: Look, standpoint: tuple[float, float]) -> list[tuple[DepthFrame, Pose]]:
    """Frames of a camera that looks around, and the poses of a base with ROS's axes."""
    level = se3.pose(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]), [*standpoint, 1.3])
    t = np.arange(60)
    turns = np.stack([0.15 * np.sin(0.3 * t), 0.06 * t, 0.15 * np.cos(0.4 * t)], axis=1)
    poses = level @ se3.exp(np.hstack([turns, np.zeros((60, 3))]))
    bases = with_axes(poses, "ros")
    return [(look(T, k), T_base) for k, (T, T_base) in enumerate(zip(poses, bases, strict=True))]
