import numpy as np
import pytest
from constellations import seen_again, view

from slam_bof.bof import (
    CONTOUR_BYTES,
    ConstellationIndex,
    ConstellationParams,
    IndexedView,
    describer_id,
    index_view,
    indexed_view,
)
from slam_bof.types import SensorParams


def test_an_index_of_saved_views_is_the_same_to_the_bit():
    described, restored = ConstellationIndex(), ConstellationIndex()
    for seed in range(60):
        one = index_view(view(seed, n=seed % 30))
        saved = one.tobytes()
        assert len(saved) == CONTOUR_BYTES * (seed % 30)
        described.add(view(seed, n=seed % 30))
        restored.add_view(IndexedView.of_bytes(saved, one.total))
    for name, column in described.columns().items():
        assert column.tobytes() == restored.columns()[name].tobytes()
    for seed in (5, 29, 44):
        query = seen_again(view(seed), 0.2, 0.1 + 0.2j)
        found, expected = restored.find(query, 20), described.find(query, 20)
        np.testing.assert_array_equal(found.view_ids, expected.view_ids)
        np.testing.assert_array_equal(found.scores, expected.scores)
        np.testing.assert_array_equal(found.motions.shift, expected.motions.shift)


def test_another_describer_is_told_apart(monkeypatch):
    params, sensor = ConstellationParams(), SensorParams()
    slices = params.slices.model_copy(update={"pixel_m": 0.05})
    ids = [
        describer_id(params, sensor),
        describer_id(params.model_copy(update={"slices": slices}), sensor),
        describer_id(params.model_copy(update={"max_contours": 39}), sensor),
        describer_id(params, sensor.model_copy(update={"max_depth_m": 3.0})),
    ]
    monkeypatch.setattr(indexed_view, "DESCRIBER_VERSION", 0)
    ids.append(describer_id(params, sensor))
    assert len(set(ids)) == 5
    assert ids[-1] == describer_id(ConstellationParams(), SensorParams())


def test_bytes_that_are_no_contours_are_refused():
    with pytest.raises(ValueError, match="buffer size"):
        IndexedView.of_bytes(b"x" * (CONTOUR_BYTES + 1), 1.0)
