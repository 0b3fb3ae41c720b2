import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes import remeasure, remeasure_labelled
from slam_bof.scenes.levelled_cloud import levelled_cloud


def test_another_sensor_sees_the_same_room():
    frame = table_frame(eye_m=1.5, pitch=0.3)
    down = np.array([0.0, np.cos(0.3), np.sin(0.3)])
    rng = np.random.default_rng(0)
    heights_m = []
    for _ in range(20):
        seen, gravity = remeasure(frame, rng, down)
        height, width = seen.depth.shape
        assert (width, height) == (seen.intrinsics.width, seen.intrinsics.height)
        cloud = levelled_cloud(seen, gravity_camera=gravity)
        heights_m.append(cloud.camera_height_m)
    assert np.median(heights_m) == pytest.approx(1.5, abs=0.05)
    assert np.ptp(heights_m) > 0.05


def test_sensors_differ_and_a_seed_repeats_them():
    frame = table_frame()
    first, again = (remeasure(frame, np.random.default_rng(7))[0] for _ in range(2))
    np.testing.assert_array_equal(first.depth, again.depth)
    rng = np.random.default_rng(0)
    n_values = [len(np.unique(remeasure(frame, rng)[0].depth)) for _ in range(30)]
    assert min(n_values) < 300 < 5000 < max(n_values)


def test_a_mirror_turns_gravity_too():
    frame, down = table_frame(), np.array([0.3, 0.9, 0.3])
    rng = np.random.default_rng(0)
    signs = {tuple(np.sign(remeasure(frame, rng, down)[1])) for _ in range(20)}
    assert signs == {(1.0, 1.0, 1.0), (-1.0, 1.0, 1.0)}


def test_nothing_stays_nothing():
    seen, gravity = remeasure(empty_frame(), np.random.default_rng(0))
    assert not seen.depth.any()
    assert gravity is None


def test_labels_stay_with_their_pixels():
    frame = table_frame(eye_m=1.5)
    near = np.asarray(frame.depth_m()) < 2.5
    rng, plain = np.random.default_rng(3), np.random.default_rng(3)
    for _ in range(10):
        seen, _, labels = remeasure_labelled(frame, near.astype(np.uint8), rng)
        np.testing.assert_array_equal(seen.depth, remeasure(frame, plain)[0].depth)
        assert labels.shape == seen.depth.shape
        clearly = (seen.depth > 0) & (np.abs(seen.depth - 2.5) > 0.4)
        assert ((seen.depth < 2.5) == labels)[clearly].mean() > 0.98
