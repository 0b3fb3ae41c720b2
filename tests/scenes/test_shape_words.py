import numpy as np
import pytest
from levelled_scene import empty_frame, table_frame

from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.scenes.shape_words import DISTANCE_SLICE_OFFSET, N_SHAPE_VALUES, shape_descriptors


def test_a_table_top_is_a_plan_of_its_size_and_height():
    shapes = shape_descriptors(levelled_cloud(table_frame(table_m=0.7)))
    *_, short, long, bottom, top, apart = shapes.T
    tops = np.flatnonzero((apart == 0) & (bottom < 0.7) & (top > 0.7))
    assert len(tops) == 1
    assert np.exp(long[tops[0]]) == pytest.approx(1.2, abs=0.1)
    assert np.exp(short[tops[0]]) == pytest.approx(0.6, abs=0.1)


def test_its_front_is_an_outline_of_its_height():
    shapes = shape_descriptors(levelled_cloud(table_frame(table_m=0.7)))
    *_, _, long, bottom, top, apart = shapes.T
    fronts = (apart == DISTANCE_SLICE_OFFSET) & (np.abs(top - 0.7) < 0.08) & (np.exp(long) > 1.0)
    assert fronts.any()
    assert bottom[fronts].min() == pytest.approx(0.0, abs=0.08)


def test_shapes_stay_when_the_camera_looks_down_more():
    one, other = (shape_descriptors(levelled_cloud(table_frame(pitch=p))) for p in (0.35, 0.45))
    sizes = [s[(s[:, -1] == 0) & (s[:, -2] < 1.0) & (s[:, -3] > 0.5)][:, -5:] for s in (one, other)]
    np.testing.assert_allclose(sizes[0], sizes[1], atol=0.15)


def test_an_empty_view_has_no_shapes():
    assert shape_descriptors(levelled_cloud(empty_frame())).shape == (0, N_SHAPE_VALUES)
