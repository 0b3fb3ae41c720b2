import json
import subprocess
import sys
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from slam_bof.synthetic.degenerate import DEGENERATE_SCENES, DegenerateCase, render_case
from slam_bof.synthetic.depth_noise import SENSORS
from slam_bof.synthetic.scene import Scene3D
from slam_bof.synthetic.tour import camera_poses

SCRIPT = Path(__file__).parents[2] / "scripts" / "measure_degenerate"


@pytest.mark.parametrize("scene", DEGENERATE_SCENES)
def test_every_scene_shows_surfaces_all_along(scene):
    case = DegenerateCase(scene, rate_hz=2.0)
    frames = list(render_case(case))
    assert len(frames) == len(case.poses())
    least = 0.2 if scene == "glass" else 0.4
    assert all(np.count_nonzero(frame.depth) > least * frame.depth.size for frame in frames)


@pytest.mark.parametrize(
    ("scene", "open_axis"), [("corridor", 0), ("wall", 1), ("floor", 1), ("ceiling", 0)]
)
def test_along_an_open_direction_all_looks_the_same(scene, open_axis):
    start = DegenerateCase(scene, motion="wheeled").poses()[0]
    moved = start.copy()
    moved[open_axis, 3] += 0.3
    world = Scene3D(DEGENERATE_SCENES[scene].make_mesh(), SENSORS["white"].intrinsics)
    here, there = world.view(start).depth_m, world.view(moved).depth_m
    near = (here > 0) & (here < 5.0)  # beyond, the ends of a corridor come nearer
    assert np.abs(here - there)[near].max() < 1e-3


def test_the_corner_leaves_height_open_and_nothing_else():
    world = Scene3D(DEGENERATE_SCENES["corner"].make_mesh(), SENSORS["white"].intrinsics)
    at = camera_poses(np.array([0.0, 0.0, 0.0]) + 0.2 * np.vstack([np.zeros(3), np.eye(3)]), 0.8, 0)
    depth = [world.view(T).depth_m for T in at]
    changed = [float(np.abs(depth[0] - other).max()) for other in depth[1:]]
    assert changed[2] < 1e-3 < 0.1 < min(changed[:2])


@pytest.mark.parametrize("sensor", SENSORS)
def test_the_same_seed_gives_the_same_bytes(sensor):
    case = DegenerateCase("room", sensor=sensor)
    first, again, other = (
        [frame.depth.tobytes() for frame in islice(render_case(case, seed=seed), 2)]
        for seed in (0, 0, 1)
    )
    assert first == again
    assert first != other


@pytest.mark.parametrize(
    ("sensor", "least", "most"),
    [
        ("white", 0.004, 0.006),
        ("kinect", 0.003, 0.02),
        ("tof", 0.002, 0.02),
        ("phone", 0.005, 0.02),
    ],
)
def test_a_wall_is_measured_with_the_noise_of_the_sensor(sensor, least, most):
    frame = next(render_case(DegenerateCase("wall", motion="wheeled", sensor=sensor)))
    depth_m = frame.depth_m()
    assert least < np.std(depth_m[depth_m > 0] - 2.5) < most


def test_before_glass_seven_pixels_of_ten_are_lost():
    case = DegenerateCase("glass", sensor="white")
    frame = next(render_case(case))
    whole = next(render_case(replace(case, scene="wall")))
    assert np.count_nonzero(frame.depth) / np.count_nonzero(whole.depth) == pytest.approx(
        0.3, abs=0.03
    )


def test_the_benchmark_tells_what_the_map_made_of_a_case():
    command = [sys.executable, str(SCRIPT), "--scene", "room", "--sensor", "white", "--rate", "10"]
    done = subprocess.run(
        [*command, "--odometry", "exact", "--json"], capture_output=True, text=True, check=True
    )
    (row,) = map(json.loads, done.stdout.splitlines())
    assert row["name"] == "room-handheld-white-10"
    assert row["odometry_max_m"] < 1e-9
    assert row["max_m"] < 0.02
    assert row["n_lost"] == 0
