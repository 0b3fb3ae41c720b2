import numpy as np
import pytest

from slam_bof.geometry import se3, view_overlap
from slam_bof.loops import CovisibilityParams, choose_covisible
from slam_bof.types import Intrinsics

CAMERA = Intrinsics(width=640, height=480, fx=585.0, fy=585.0, cx=320.0, cy=240.0)


@pytest.fixture
def wall():
    x, y = np.meshgrid(np.linspace(-1.0, 1.0, 21), np.linspace(-0.7, 0.7, 15))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1)


def overlap_after(motion, points, max_range_m=5.0):
    others = np.stack([motion])
    return view_overlap(points, np.eye(4), others, CAMERA, max_range_m)[0]


def test_same_view_overlaps_wholly(wall):
    assert overlap_after(np.eye(4), wall) == 1.0


def test_view_from_behind_does_not_overlap(wall):
    turned = se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))
    assert overlap_after(turned, wall) == 0.0


def test_half_a_view_aside_halves_the_overlap(wall):
    aside = se3.pose(np.eye(3), [1.05, 0.0, 0.0])
    assert overlap_after(aside, wall) == pytest.approx(0.5, abs=0.05)


def test_surfaces_out_of_range_do_not_count(wall):
    back = se3.pose(np.eye(3), [0.0, 0.0, -2.0])
    assert overlap_after(back, wall, max_range_m=5.0) == 1.0
    assert overlap_after(back, wall, max_range_m=3.0) == 0.0


def test_overlap_does_not_depend_on_the_map_frame(wall):
    T_world_map = se3.exp(np.array([0.3, -0.2, 0.5, 1.0, 2.0, 3.0]))
    other = se3.exp(np.array([0.1, 0.2, 0.0, 0.3, 0.0, 0.1]))
    here = view_overlap(wall, np.eye(4), other[None], CAMERA, 5.0)
    there = view_overlap(wall, T_world_map, (T_world_map @ other)[None], CAMERA, 5.0)
    assert here == pytest.approx(there)


@pytest.mark.parametrize("n_others", [0, 3])
def test_empty_input_gives_no_overlap(n_others):
    others = np.tile(np.eye(4), (n_others, 1, 1))
    overlaps = view_overlap(np.empty((0, 3)), np.eye(4), others, CAMERA, 5.0)
    assert overlaps.shape == (n_others,)
    assert not overlaps.any()


def test_the_best_are_chosen_apart_from_each_other_and_bounded():
    overlaps = np.array([0.5, 0.8, 0.7, 0.2, 0.6, 0.9, 0.95])
    apart = CovisibilityParams(min_overlap=0.35, separation=2)
    ids = np.arange(7)
    assert choose_covisible(ids, overlaps, apart) == [1, 4, 6]
    assert choose_covisible(ids, overlaps, apart.model_copy(update={"max_edges": 2})) == [1, 6]
    # Keyframes between 4 and 9 were culled.
    assert choose_covisible(np.array([0, 1, 2, 3, 4, 9, 10]), overlaps, apart) == [1, 4, 10]
    assert choose_covisible(np.array([0, 1, 2, 3, 4, 9, 20]), overlaps, apart) == [1, 4, 9, 20]
    np.testing.assert_array_equal(overlaps[:2], [0.5, 0.8])  # the input is left alone


def test_no_edges_when_turned_off_or_nothing_overlaps():
    ids = np.arange(5)
    assert choose_covisible(ids, np.full(5, 0.9), CovisibilityParams(max_edges=0)) == []
    assert choose_covisible(ids, np.full(5, 0.1), CovisibilityParams()) == []
