import dataclasses
import pickle
from typing import Any

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


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ((0.0, 140.0, 79.5, 59.5), "focal length fx of 0 px for an image of 160x120 pixels"),
        ((140.0, -140.0, 79.5, 59.5), "focal length fy of -140 px"),
        ((np.nan, 140.0, 79.5, 59.5), "focal length fx of nan px"),
        ((np.inf, 140.0, 79.5, 59.5), "focal length fx of inf px"),
        ((0.875, 1.17, 79.5, 59.5), "expected at least 8 px"),  # shares of the image's size
        ((1050.0, 1050.0, 596.0, 446.0), "principal point at cx = 596 px"),  # another image size
        ((140.0, 140.0, 79.5, 446.0), "cy = 446 px .* between 6 and 114 px"),
        ((140.0, 140.0, 0.5, 0.5), "cx = 0.5 px"),
        ((140.0, 140.0, np.nan, 59.5), "cx = nan px"),
    ],
)
def test_intrinsics_that_cannot_be_of_the_images_are_refused(
    numbers: tuple[float, ...], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Intrinsics(160, 120, *numbers)


def test_intrinsics_are_plain_numbers_whatever_they_are_given_as() -> None:
    K = np.array([140.5, 140.5, 79.5, 59.5], np.float32)
    camera = Intrinsics(np.int64(160), np.uint16(120), *K)  # type: ignore[arg-type]
    assert camera == Intrinsics(160, 120, 140.5, 140.5, 79.5, 59.5)
    kinds = {type(value) for value in dataclasses.astuple(camera)}
    assert kinds == {int, float}
    with pytest.raises(ValueError, match=r"found width = 160.5, expected a whole number"):
        Intrinsics(160.5, 120, 140.0, 140.0, 79.5, 59.5)  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="image of 0x120 pixels"):
        Intrinsics(0, 120, 140.0, 140.0, 79.5, 59.5)


@pytest.mark.parametrize("value", [None, "x", [], 1j, 10**400, np.datetime64("2026-01-01")])
def test_intrinsics_that_are_no_numbers_are_named(value: Any) -> None:
    with pytest.raises(ValueError, match=r"found fy = .*, expected a number"):
        Intrinsics(160, 120, 140.0, value, 79.5, 59.5)
    with pytest.raises(ValueError, match="height"):
        Intrinsics(160, value, 140.0, 140.0, 79.5, 59.5)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
def test_depth_beyond_any_unit_is_missing(kind: type) -> None:
    numbers = [1.0, 2e12, 1e38, 1e300 if kind is np.float64 else 1e38, np.inf, np.nan, -1.0, 0.0]
    frame = DepthFrame(0.0, np.array([numbers], kind), Intrinsics(8, 1, 8.0, 1.0, 3.5, 0.0))
    assert frame.depth_m().tolist() == [[1.0, *[0.0] * 7]]


@pytest.mark.parametrize(
    ("stamps_s", "poses", "message"),
    [
        ([0.0], np.eye(4)[None], "stamps_s must be an array of numbers, got list"),
        (np.zeros(1), None, "poses must be an array of numbers, got NoneType"),
        (np.zeros(1), np.array([["x"]]), "poses must be an array of numbers, got <U1"),
        (np.zeros((1, 1)), np.eye(4)[None], "stamps_s must be"),
        (np.zeros(2), np.eye(4)[None], "poses must be"),
    ],
)
def test_what_is_no_trajectory_is_refused(stamps_s: Any, poses: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Trajectory(stamps_s, poses)


def test_a_trajectory_is_shown_in_one_line() -> None:
    poses = np.tile(np.eye(4), (900, 1, 1))
    assert repr(Trajectory(np.arange(900) / 2, poses)) == (
        "Trajectory(900 poses from 0.0 to 449.5 s)"
    )
    assert repr(Trajectory()) == "Trajectory(no poses)"
