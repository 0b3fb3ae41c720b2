"""Which directions surfaces hold, on scenes that are open by construction."""

import numpy as np
import pytest

from slam_bof.geometry import (
    AlignmentParams,
    ViewAligner,
    make_view,
    open_directions,
    se3,
    search_weak_directions,
    weak_direction_search,
)
from slam_bof.synthetic import DEGENERATE_SCENES, SENSORS, DegenerateCase
from slam_bof.synthetic.scene import Scene3D
from slam_bof.types import DepthFrame

MATCH, QUERY = 0, 1


def look(scene, poses, sensor="white", seed=0):
    """Return an aligner with the views from poses (n, 4, 4)."""
    sensor, rng = SENSORS[sensor], np.random.default_rng(seed)
    world = Scene3D(DEGENERATE_SCENES[scene].make_mesh(), sensor.intrinsics)
    aligner = ViewAligner(AlignmentParams(n_points=1000, n_iterations=8, gates_m=(0.15, 0.03)))
    for k, T in enumerate(poses):
        depth = sensor.measure(world.view(T), rng)
        aligner.add(make_view(DepthFrame(float(k), depth, sensor.intrinsics)))
    return aligner


def pair(scene, sensor="white"):
    """Return an aligner with two views of a scene, and the true T_match_query."""
    poses = DegenerateCase(scene, sensor=sensor).poses()[[10, 20]]
    return look(scene, poses, sensor), se3.inverse(poses[0]) @ poses[1]


@pytest.mark.parametrize("sensor", SENSORS)
@pytest.mark.parametrize(
    ("scene", "n_open"), [("wall", 3), ("floor", 3), ("corner", 1), ("corridor", 1), ("room", 0)]
)
def test_directions_are_open_that_the_scene_leaves_open(scene, n_open, sensor):
    aligner, T = pair(scene, sensor)
    _, axes = open_directions(aligner, QUERY, MATCH, T)
    assert axes.shape == (6, n_open)


def test_a_corridor_is_open_along_itself():
    aligner, T = pair("corridor")
    directions, axes = open_directions(aligner, QUERY, MATCH, T)
    forward = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert abs(axes[:, 0] @ forward) > 0.9
    information = directions.without(np.eye(6) * 1000.0, axes)
    tangent = np.linalg.solve(directions.of_tangent(), axes[:, 0])
    assert tangent @ information @ tangent < 0.1
    assert np.linalg.eigvalsh(information)[1] > 900.0


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75, 1.0])
def test_alignment_before_a_wall_is_not_drawn_to_whole_pixels(share):
    start = DegenerateCase("wall", motion="wheeled").poses()[0]
    pixel_m = 2.5 / (SENSORS["white"].intrinsics.fx / 4)
    moved = start.copy()
    moved[1, 3] += share * pixel_m
    T = se3.inverse(start) @ moved
    (found,) = look("wall", [start, moved]).refine(QUERY, np.array([MATCH]), T[None])
    slid = (se3.inverse(T) @ found)[0, 3]
    assert abs(slid) < 0.2 * pixel_m


def test_what_is_kept_open_is_the_guess_and_nothing_else_is():
    aligner, T = pair("corridor")
    directions, axes = open_directions(aligner, QUERY, MATCH, T)
    ahead, aside = np.eye(4), np.eye(4)
    ahead[2, 3], aside[0, 3] = 0.05, 0.05
    kept = directions.keep(axes, T, T @ ahead)
    assert se3.inverse(T) @ kept == pytest.approx(ahead, abs=0.01)
    kept = directions.keep(axes, T, T @ aside)
    assert se3.inverse(T) @ kept == pytest.approx(np.eye(4), abs=0.01)


@pytest.mark.parametrize("off_deg", [-2.0, 1.0])
def test_before_a_wall_a_camera_is_turned_about_itself(off_deg):
    """Alignment mends the turn and the distance; odometry alone says where along the wall it is."""
    aligner, T = pair("wall")
    turn = se3.exp(np.array([0.0, np.radians(off_deg), 0.0, 0.0, 0.0, 0.0]))
    by_odometry = T @ turn
    (aligned,) = aligner.refine(QUERY, np.array([MATCH]), by_odometry[None])
    directions, axes = open_directions(aligner, QUERY, MATCH, aligned)
    kept = directions.keep(axes, aligned, by_odometry)
    assert se3.rotation_angle(se3.inverse(T) @ kept) < np.radians(0.1)
    assert kept[:3, 3] == pytest.approx(T[:3, 3], abs=0.002)


def test_a_wrong_minimum_on_a_floor_is_left_for_the_right_one():
    aligner, T = pair("box", "kinect")
    wrong = T.copy()
    wrong[:3, 3] += T[:3, :3] @ [0.15, 0.0, 0.0]
    (stuck,) = aligner.refine(QUERY, np.array([MATCH]), wrong[None])
    found = search_weak_directions(aligner, QUERY, MATCH, stuck, wrong[None], seed=0)
    assert np.linalg.norm((se3.inverse(T) @ found)[:3, 3]) < 0.02


def test_a_search_starts_from_the_poses_it_is_given(monkeypatch):
    monkeypatch.setattr(weak_direction_search, "SEARCH_ROUNDS", ((0, 0.1, 0),))
    aligner, T = pair("box", "kinect")
    wrong = T.copy()
    wrong[:3, 3] += T[:3, :3] @ [0.15, 0.0, 0.0]
    (stuck,) = aligner.refine(QUERY, np.array([MATCH]), wrong[None])
    found = search_weak_directions(aligner, QUERY, MATCH, stuck, np.stack([wrong, T]), seed=0)
    assert np.linalg.norm((se3.inverse(T) @ found)[:3, 3]) < 0.02
    # A pose that agrees no better is not taken, however near to the right one it started.
    assert search_weak_directions(aligner, QUERY, MATCH, found, T[None], seed=0) is found


def test_without_a_common_surface_nothing_is_known():
    poses = DegenerateCase("room", sensor="white").poses()[:1].repeat(2, axis=0)
    poses[1, :3, :3] = poses[0, :3, :3] @ se3.exp(np.array([0, np.pi, 0, 0, 0, 0]))[:3, :3]
    aligner = look("room", poses)
    assert open_directions(aligner, QUERY, MATCH, se3.inverse(poses[0]) @ poses[1]) is None
