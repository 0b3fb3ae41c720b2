"""Sequences whose unit of depth or camera is another than assumed."""

import numpy as np
import pytest
from conftest import CAMERA, box_room_depth_mm

from slam_bof.datasets import doubts_of_image, find_doubts
from slam_bof.errors import DatasetError
from slam_bof.types import DepthFrame, Intrinsics


class Sequence:
    """40 frames of a box room, whose depth is wrong by a factor."""

    def __init__(self, factor, camera, damaged):
        self.intrinsics = camera
        self._depth_m = factor / 1000 * box_room_depth_mm(CAMERA, np.eye(4))
        self._damaged = damaged

    def __len__(self):
        return 40

    def frame(self, index):
        if index in self._damaged:
            raise DatasetError("damaged")
        return DepthFrame(float(index), self._depth_m, self.intrinsics)


def doubts(factor=1.0, camera=CAMERA, damaged=()):
    return find_doubts(Sequence(factor, camera, damaged))


def test_a_room_leaves_no_doubt():
    assert doubts() == []
    assert doubts(0.0) == []  # nothing seen, nothing wrong
    assert doubts(damaged=range(40)) == []


@pytest.mark.parametrize(
    ("factor", "likely"),
    [
        (4.0, "divided by 4 (units of 0.25 mm, as of RealSense L515)"),
        (10.0, "divided by 10 (units of 0.1 mm, as of RealSense D405)"),
        (1000.0, "divided by 1000 (millimetres read as metres)"),
        (1e-3, "divided by 0.001 (metres read as millimetres)"),
    ],
)
def test_a_wrong_unit_is_named(factor, likely):
    (doubt,) = doubts(factor, damaged=[0])
    assert likely in doubt
    assert ("beyond 8 m" if factor > 1 else "below 0.1 m") in doubt


@pytest.mark.parametrize(
    ("factor", "likely"), [(0.2, "divided by 0.2 (millimetres"), (0.1, "divided by 0.1 (")]
)
def test_a_room_too_small_to_be_one_is_named(factor, likely):
    (doubt,) = doubts(factor)
    assert "nearer than rooms are: the unit of depth is probably wrong" in doubt
    assert likely in doubt


def test_a_single_image_may_be_a_close_up_but_not_of_millimetres():
    depth_m = 0.2 / 1000 * box_room_depth_mm(CAMERA, np.eye(4))
    assert doubts_of_image(DepthFrame(0.0, depth_m, CAMERA)) == []
    (doubt,) = doubts_of_image(DepthFrame(0.0, 0.4 * depth_m, CAMERA))
    assert "nearer than rooms are" in doubt


def test_a_unit_that_nobody_uses_is_told_all_the_same():
    (doubt,) = doubts(1e9)
    assert "the unit of depth is probably wrong; depth_scale" in doubt


def test_a_principal_point_of_the_turned_image_is_told():
    (doubt,) = doubts(camera=Intrinsics(160, 120, 146.25, 146.25, 59.5, 79.5))
    assert "(59.5, 79.5) is that of an image of 120x160 pixels" in doubt
    assert doubts(camera=Intrinsics(160, 120, 146.25, 146.25, 75.0, 66.0)) == []
