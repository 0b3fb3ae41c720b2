import dataclasses
import pickle

import numpy as np
import pytest
from pydantic import ValidationError

from slam_bof.types import Contours, DepthFrame, Intrinsics, Params, Trajectory

CAMERA = Intrinsics(width=3, height=2, fx=100.0, fy=100.0, cx=1.0, cy=1.0)


def test_pickles_of_earlier_versions_find_their_class() -> None:
    assert pickle.loads(b"cslam_bof.types\nIntrinsics\n.") is Intrinsics


def test_uint16_depth_is_millimetres_with_two_missing_values() -> None:
    depth = np.array([[0, 65535, 1], [500, 1234, 65534]], dtype=np.uint16)
    depth_m = DepthFrame(0.0, depth, CAMERA).depth_m()
    assert depth_m.dtype == np.float32
    expected = np.array([[0.0, 0.0, 0.001], [0.5, 1.234, 65.534]])
    np.testing.assert_allclose(depth_m, expected, rtol=1e-6)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_float_depth_is_metres_and_what_is_no_distance_is_missing(dtype: type) -> None:
    depth = np.array([[np.nan, np.inf, -np.inf], [-1.0, 0.0, 2.5]], dtype=dtype)
    depth_m = DepthFrame(0.0, depth, CAMERA).depth_m()
    assert depth_m.dtype == np.float32
    np.testing.assert_array_equal(depth_m, [[0, 0, 0], [0, 0, 2.5]])


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_stride_takes_every_nth_pixel_and_leaves_the_image_alone(dtype: type) -> None:
    depth = np.arange(1, 7, dtype=dtype).reshape(2, 3)
    depth[0, 0] = 65535 if dtype is np.uint16 else np.nan
    before = depth.copy()
    frame = DepthFrame(0.0, depth, CAMERA)
    np.testing.assert_array_equal(frame.depth_m(2), frame.depth_m()[::2, ::2])
    np.testing.assert_array_equal(depth, before)


def test_depth_must_have_the_size_that_the_intrinsics_say() -> None:
    with pytest.raises(ValueError, match=r"must be \(2, 3\) like its intrinsics, got \(3, 2\)"):
        DepthFrame(0.0, np.zeros((3, 2), np.uint16), CAMERA)
    with pytest.raises(ValueError, match=r"got \(2, 3, 3\)"):
        DepthFrame(0.0, np.zeros((2, 3, 3), np.uint16), CAMERA)


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.bool_])
def test_depth_of_another_type_is_refused(dtype: type) -> None:
    with pytest.raises(ValueError, match="uint16 mm or float m, got"):
        DepthFrame(0.0, np.zeros((2, 3), dtype), CAMERA)


def test_a_trajectory_has_a_pose_for_each_stamp() -> None:
    assert len(Trajectory()) == 0
    assert len(Trajectory(np.arange(2.0), np.zeros((2, 4, 4)))) == 2
    with pytest.raises(ValueError, match=r"must be \(2, 4, 4\), got \(3, 4, 4\)"):
        Trajectory(np.arange(2.0), np.zeros((3, 4, 4)))
    with pytest.raises(ValueError, match=r"must be \(2, 4, 4\), got \(2, 3, 4\)"):
        Trajectory(np.arange(2.0), np.zeros((2, 3, 4)))


def test_contours_count_themselves() -> None:
    points = (np.zeros((4, 2), np.int32), np.zeros((9, 2), np.int32))
    assert len(Contours(points, np.array([0, 3], np.int32))) == 2


def test_records_are_frozen() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        CAMERA.fx = 1.0  # type: ignore[misc]


class Knobs(Params):
    n: int = 3


def test_parameters_are_frozen_and_know_their_keys() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        Knobs().n = 4
    with pytest.raises(ValidationError, match="Extra inputs are not permitted"):
        Knobs.model_validate({"m": 4})
