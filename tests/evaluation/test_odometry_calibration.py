"""Clock, scale and axes between depth and odometry, of motion that is known."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from slam_bof.cli.app import app
from slam_bof.evaluation import FrameMotion, calibrate, measure_motions
from slam_bof.geometry import delayed, se3
from slam_bof.types import SensorParams, Trajectory


def pose_at(t):
    """The pose of a camera that a hand waves about."""
    turn = [0.4 * np.sin(1.7 * t), 0.6 * np.sin(1.1 * t + 1), 0.2 * np.sin(2.3 * t + 2)]
    shift = [0.5 * np.sin(0.9 * t), 0.2 * np.sin(1.3 * t), 0.4 * np.sin(0.7 * t + 1)]
    return se3.pose(se3.exp(np.array([*turn, 0, 0, 0]))[:3, :3], shift)


def wave(offset_s, scale, tilt_rad, *, noise=(0.002, 0.004), seed=0):
    """Return motions by alignment, and odometry that differs by offset, scale and tilt."""
    rng = np.random.default_rng(seed)
    stamps_s = np.arange(0.0, 30.0, 1 / 15)
    T_camera_odometry = se3.exp(np.array([*tilt_rad, 0, 0, 0]))
    odometry = [pose_at(t - offset_s) @ T_camera_odometry for t in stamps_s]
    motions = []
    for a, b in zip(stamps_s[3:-9:6], stamps_s[9:-3:6], strict=True):
        T = se3.inverse(pose_at(a)) @ pose_at(b)
        T[:3, 3] /= scale
        T = T @ se3.exp(np.repeat(noise, 3) * rng.standard_normal(6))
        motions.append(FrameMotion(a, b, T, True))
    return motions, Trajectory(stamps_s, np.array(odometry))


@pytest.mark.parametrize("offset_s", [0.0, -0.025, 0.06])
@pytest.mark.parametrize(("scale", "tilt_deg"), [(1.0, 0.0), (0.977, 0.0), (1.05, 5.0)])
def test_clock_scale_and_axes_are_found(offset_s, scale, tilt_deg):
    tilt_rad = np.radians([tilt_deg, -tilt_deg, 0.0])
    found = calibrate(*wave(offset_s, scale, tilt_rad))
    assert found.time_offset_s == pytest.approx(offset_s, abs=4 * found.time_offset_sigma_s)
    assert found.depth_scale == pytest.approx(scale, abs=4 * found.depth_scale_sigma)
    assert (np.abs(found.tilt_rad - tilt_rad) < 4 * found.tilt_sigma_rad + 1e-3).all()
    assert found.time_offset_sigma_s < 0.002
    assert found.depth_scale_sigma < 0.005


@pytest.mark.parametrize("offset_s", [-0.05, 0.06])
def test_poses_that_are_moved_by_what_was_found_are_by_the_clock_of_depth(offset_s):
    motions, odometry = wave(offset_s, 1.0, np.zeros(3))
    moved = delayed(odometry, -calibrate(motions, odometry).time_offset_s)
    known = np.isfinite(moved.poses).all(axis=(1, 2))
    assert known.sum() >= len(known) - 2
    again = calibrate(motions[2:-2], Trajectory(moved.stamps_s[known], moved.poses[known]))
    assert abs(again.time_offset_s) < 4 * again.time_offset_sigma_s
    assert abs(again.time_offset_s) < 0.1 * abs(offset_s)


def test_standard_deviations_are_those_of_the_errors():
    found = [calibrate(*wave(0.01, 0.99, np.zeros(3), seed=seed)) for seed in range(20)]
    errors = np.array([[f.time_offset_s - 0.01, f.depth_scale - 0.99] for f in found])
    sigmas = np.array([[f.time_offset_sigma_s, f.depth_scale_sigma] for f in found])
    assert np.sqrt(np.mean(np.square(errors / sigmas), axis=0)) == pytest.approx([1, 1], abs=0.6)


def test_some_wrong_alignments_do_not_matter():
    motions, odometry = wave(0.02, 0.98, np.zeros(3))
    for k in range(0, len(motions), 8):
        T = motions[k].T_a_b.copy()
        T[:3, 3] += 0.3
        motions[k] = motions[k]._replace(T_a_b=T)
    found = calibrate(motions, odometry)
    assert found.time_offset_s == pytest.approx(0.02, abs=0.003)
    assert found.depth_scale == pytest.approx(0.98, abs=0.015)


def test_of_sparse_poses_the_clock_is_unknown():
    motions, odometry = wave(0.0, 0.98, np.zeros(3))
    found = calibrate(motions, Trajectory(odometry.stamps_s[::6], odometry.poses[::6]))
    assert found.time_offset_s == pytest.approx(0.0, abs=1e-6)
    assert np.isinf(found.time_offset_sigma_s)


def test_too_little_motion_tells_nothing():
    motions, odometry = wave(0.0, 1.0, np.zeros(3))
    assert calibrate(motions[:10], odometry) is None
    open_ones = [motion._replace(is_held=False) for motion in motions]
    assert calibrate(open_ones, odometry) is None


def test_motions_are_those_between_views(walk):
    motions = measure_motions(walk)
    assert len(motions) > 20
    truth = {frame.stamp_s: T for frame, T in walk}
    for motion in motions:
        expected = se3.inverse(truth[motion.stamp_a_s]) @ truth[motion.stamp_b_s]
        assert motion.T_a_b == pytest.approx(expected, abs=0.03)


def test_frames_are_corrected_once(walk):
    frame, _ = walk[0]
    sensor = SensorParams(depth_scale=0.9)
    corrected = frame.corrected(sensor)
    assert corrected.depth_m() == pytest.approx(0.9 * frame.depth_m(), rel=1e-6)
    assert corrected.corrected(sensor) is corrected
    assert frame.corrected(frame.sensor) is frame


def test_the_command_says_what_to_set(tmp_path, write_turn):
    folder = tmp_path / "turn"
    write_turn(folder, list(np.arange(0.0, 6.2, 0.1)), [0.2 * np.sin(k / 3) for k in range(62)])
    result = CliRunner().invoke(app, ["check", str(folder), "--json", "-q"])
    assert result.exit_code == 0
    found = json.loads(result.stdout)
    assert found["n_motions"] > 40
    assert found["advice"] == []
    arguments = ["check", str(folder), "--json", "-q", "--set", "sensor.depth_scale=0.9"]
    found = json.loads(CliRunner().invoke(app, arguments).stdout)
    assert found["depth_scale"] == pytest.approx(1.0, abs=4 * found["depth_scale_sigma"])
    (advice,) = [line for line in found["advice"] if "depth_scale" in line]
    assert f"sensor.depth_scale={found['depth_scale']:.4f}" in advice
