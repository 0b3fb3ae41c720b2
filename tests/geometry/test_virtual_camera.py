"""Point clouds without a depth image."""

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof import evaluation
from slam_bof.geometry import CloudCamera, back_project, se3
from slam_bof.geometry.virtual_camera import render
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.config import override
from slam_bof.synthetic import Lidar, LidarParams, make_flat, make_tour
from slam_bof.types import DepthFrame, Intrinsics, Trajectory

ROOM = DepthFrame(0.0, box_room_depth_mm(CAMERA, np.eye(4)), CAMERA)
CLOUD = back_project(ROOM.depth_m(), CAMERA)


def sphere(n, seed=0):
    directions = np.random.default_rng(seed).normal(size=(n, 3))
    return 2.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)


def test_a_depth_image_is_made_again():
    np.testing.assert_allclose(render(CLOUD, CAMERA), ROOM.depth_m(), rtol=1e-6)


def test_the_order_of_points_does_not_matter():
    shuffled = np.random.default_rng(0).permutation(CLOUD)
    np.testing.assert_allclose(render(shuffled, CAMERA), render(CLOUD, CAMERA), rtol=1e-6)


def test_what_is_behind_is_hidden_and_what_is_beside_is_out():
    wall = CLOUD * [1, 1, 0] + [0, 0, 3]
    behind = np.array([[0.0, 0.0, 5.0], [0.0, 0.0, -1.0], [9.0, 0.0, 1.0], [0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(
        render(np.vstack([wall, behind]), CAMERA), render(np.vstack([behind, wall]), CAMERA)
    )
    assert render(np.vstack([wall, behind]), CAMERA).max() < 3.01


def test_holes_of_a_slanted_plane_are_closed_on_it_and_edges_are_not():
    camera = Intrinsics(40, 30, 40.0, 40.0, 19.5, 14.5)
    u, v = np.meshgrid(np.arange(40), np.arange(30))
    plane = 1.0 / (0.5 + 0.1 * (u - 19.5) / 40.0 + 0.2 * (v - 14.5) / 40.0)
    rings = np.where(v % 4 == 0, plane, 0.0)  # as of a LiDAR
    found = render(back_project(rings, camera), camera)
    np.testing.assert_allclose(found[:29], plane[:29], rtol=1e-4)
    assert not found[29:].any(), "beyond the last ring nothing is known"
    step = np.where(u < 20, 1.0, 3.0) * (np.abs(u - 20) > 1)
    found = render(back_project(step, camera), camera)
    np.testing.assert_allclose(found, step, rtol=1e-6)


def test_an_empty_cloud_is_a_blind_frame():
    seen = CloudCamera().observe(1.5, np.empty((0, 3)), np.eye(4))
    assert seen.frame.stamp_s == 1.5
    assert not seen.frame.depth.any()


def test_a_cloud_of_a_depth_camera_is_seen_from_where_it_was_taken():
    camera = CloudCamera()
    T_odom_camera = se3.exp(np.array([0.1, 2.0, 0.3, 1.0, 2.0, 3.0]))
    frame, T_camera_view = camera.observe(0.0, CLOUD, T_odom_camera)
    np.testing.assert_array_equal(T_camera_view, np.eye(4))
    assert (frame.depth > 0).mean() > 0.93
    half_width = 0.5 * frame.intrinsics.width / frame.intrinsics.fx
    assert half_width == pytest.approx(80.0 / 146.25, rel=0.03)
    again, _ = camera.observe(1.0, CLOUD[::7], T_odom_camera)
    assert again.intrinsics == frame.intrinsics


def test_the_configuration_sets_the_size_of_the_image():
    records = []
    config = override(preset("indoor"), ["virtual_camera.width_px=[80, 100]"])
    LoopCloser.from_config(config, journal=records.append).process_points(0.0, CLOUD, np.eye(4))
    assert records[0].depth.intrinsics.width == 100


def test_one_from_all_around_is_seen_the_same_way_however_the_sensor_turns():
    cloud = sphere(60000) + np.array([0.5, 0.2, -0.3])
    camera = CloudCamera()
    first = camera.observe(0.0, cloud, np.eye(4))
    turned = se3.exp(np.array([0.2, 2.5, -0.1, 0.0, 0.0, 0.0]))
    second = camera.observe(1.0, se3.transform(se3.inverse(turned), cloud), turned)
    np.testing.assert_allclose((turned @ second.T_camera_view), np.eye(4), atol=1e-9)
    np.testing.assert_allclose(second.frame.depth, first.frame.depth, atol=1e-5)
    assert (first.frame.depth > 0).mean() > 0.9


@pytest.mark.parametrize("cloud", [np.zeros((3, 4)), np.zeros(3)])
def test_what_is_no_cloud(cloud):
    with pytest.raises(ValueError, match=r"points_camera must be numbers \(N, 3\), got"):
        LoopCloser.from_preset().process_points(0.0, cloud, np.eye(4))


def test_points_that_are_not_finite_are_dropped():
    broken = np.vstack([CLOUD, np.full((50, 3), np.nan), [[np.inf, 0, 1]]])
    found, wanted = (CloudCamera().observe(0.0, cloud, np.eye(4)) for cloud in (broken, CLOUD))
    np.testing.assert_array_equal(found.frame.depth, wanted.frame.depth)


def test_clouds_that_show_nothing_at_first_do_no_harm():
    closer = LoopCloser.from_preset()
    T = se3.pose(np.eye(3), [0.0, 0.0, 0.1])
    for stamp_s, cloud in enumerate((np.empty((0, 3)), CLOUD[:5], CLOUD, CLOUD)):
        closer.process_points(float(stamp_s), cloud, T)
    np.testing.assert_allclose(closer.finish().poses, [T] * 4, atol=1e-6)
    assert len(closer.map.keyframes) == 1


def test_loops_are_closed_on_a_lidar_tour():
    """Through the flat and back into the first room, with odometry that drifts all the while."""
    flat = make_flat()
    truth = make_tour(flat)[::9]
    lidar = Lidar(flat.mesh, LidarParams(n_rings=32, n_columns=512))
    drift = se3.exp(np.array([0.0009, 0.0024, 0.0006, 0.0024, 0.0006, 0.0024]))
    odometry = [np.eye(4)]
    for step in se3.inverse(truth[:-1]) @ truth[1:]:
        odometry.append(odometry[-1] @ step @ drift)
    closer = LoopCloser.from_preset()
    stamps_s = 0.3 * np.arange(len(truth))
    n_lost = 0
    for index, T in enumerate(odometry):
        points = lidar.scan(truth[index], seed=index)
        step = closer.process_points(stamps_s[index], points, T)
        n_lost += step.is_lost
    found = closer.finish()
    reference = Trajectory(stamps_s, truth)
    before = evaluation.ate(Trajectory(stamps_s, np.array(odometry)), reference)
    after = evaluation.ate(found, reference)
    assert n_lost == 0
    assert sum(loop.kind == "loop" for loop in closer.map.loops) > 20
    assert before.rmse_m > 0.15
    assert after.rmse_m < 0.04
