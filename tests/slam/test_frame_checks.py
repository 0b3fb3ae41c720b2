"""What a loop closer says of frames that are probably not what they are taken for."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.errors import FrameWarning
from slam_bof.slam import LoopCloser, preset
from slam_bof.slam.frame_checks import FrameChecks
from slam_bof.types import DepthFrame, SensorParams

DEPTH_MM = box_room_depth_mm(CAMERA, np.eye(4))
N_FRAMES = 30


def check(
    depth: np.ndarray, sensor: SensorParams | None = None, *, second: float = 1.0
) -> list[str]:
    """Return what is warned of the same depth image at 30 Hz; stamps have that unit."""
    checks = FrameChecks(sensor)
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for k in range(N_FRAMES):
            checks.check(DepthFrame(k * second / 30, depth, CAMERA), (k - 1) * second / 30)
    assert all(w.category is FrameWarning for w in said)
    return [str(w.message) for w in said]


def test_millimetres_and_metres_leave_no_doubt() -> None:
    assert check(DEPTH_MM) == []
    assert check(DEPTH_MM / 1000.0) == []
    assert check(np.zeros_like(DEPTH_MM)) == []


@pytest.mark.parametrize(
    ("depth", "likely"),
    [
        (DEPTH_MM.astype(np.float32), "divided by 1000 (millimetres read as metres)"),
        (5 * DEPTH_MM, "divided by 5 (units of 0.2 mm, as in TUM's files)"),
    ],
)
def test_another_unit_is_warned_of_once_with_what_is_expected(
    depth: np.ndarray, likely: str
) -> None:
    (said,) = check(depth)
    assert likely in said
    assert said.endswith("DepthFrame takes uint16 in millimetres or floats in metres")


def test_stamps_in_milliseconds_are_warned_of() -> None:
    assert check(DEPTH_MM, second=1e3) == ["frames are 33.3 s apart: are time stamps in seconds?"]
    assert check(DEPTH_MM, second=30.0) == []  # a frame a second


def test_a_sensor_that_sees_farther_may() -> None:
    assert check(5 * DEPTH_MM, SensorParams(max_depth_m=40.0)) == []


def test_the_warning_names_the_line_that_gives_the_frames() -> None:
    closer = LoopCloser.from_config(preset("indoor"))
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for k in range(N_FRAMES):
            closer.process(DepthFrame(k / 30, DEPTH_MM.astype(np.float32), CAMERA), np.eye(4))
    assert [w.filename for w in said] == [__file__]
