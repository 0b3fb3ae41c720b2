import numpy as np
import pytest
from levelled_scene import CAMERA, empty_frame, table_frame

from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.types import DepthFrame


@pytest.mark.parametrize(("pitch", "roll"), [(0.25, 0.0), (0.4, 0.1), (0.5, -0.2)])
def test_a_tilted_camera_is_levelled_and_its_height_found(pitch, roll):
    view = levelled_cloud(table_frame(eye_m=1.3, pitch=pitch, roll=roll))
    assert view.floor_seen
    assert view.camera_height_m == pytest.approx(1.3, abs=0.03)
    up = view.grid_normals[view.grid_normals[..., 1] < -0.9]
    assert len(up) > 200
    assert np.median(up[:, 1]) < -0.999


def test_the_table_is_not_taken_for_the_floor():
    high = levelled_cloud(table_frame(table_m=0.9, eye_m=1.6, ahead_m=1.6))
    assert high.camera_height_m == pytest.approx(1.6, abs=0.03)


def test_what_is_known_of_gravity_is_used():
    # On its side, further than surfaces alone tell.
    upright = table_frame(pitch=0.4)
    down = np.array([0.0, np.cos(0.4), np.sin(0.4)])
    R = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    square = np.ascontiguousarray(np.rot90(upright.depth[:, 40:280]))
    camera = type(CAMERA)(240, 240, 292.5, 292.5, 120.0, 120.0)
    turned = DepthFrame(0.0, square, camera)
    told = levelled_cloud(turned, gravity_camera=R @ down)
    assert told.camera_height_m == pytest.approx(1.5, abs=0.05)


def test_without_a_floor_in_view_the_height_is_guessed():
    view = levelled_cloud(table_frame(pitch=-0.3))
    assert not view.floor_seen
    assert view.camera_height_m == 1.4


def test_a_low_camera_sees_what_may_be_the_floor():
    view = levelled_cloud(table_frame(eye_m=0.5, pitch=0.5, ahead_m=6.0))
    assert (view.camera_height_m, view.floor_seen) == (1.4, False)
    assert view.possible_height_m == pytest.approx(0.5, abs=0.03)


def test_a_table_above_something_lower_is_no_floor():
    # So near that the table fills the lower half of the image; beside it the floor is seen.
    view = levelled_cloud(table_frame(table_m=0.9, eye_m=1.5, ahead_m=0.9, pitch=0.5))
    assert view.possible_height_m is None


def test_nothing_seen_is_no_error():
    view = levelled_cloud(empty_frame())
    assert view.points.shape == (0, 3)
    assert (view.camera_height_m, view.floor_seen) == (1.4, False)
