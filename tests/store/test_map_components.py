"""Which part of a saved map is taken where its components are not comparable."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from saved_maps import make_keyframe, save

from slam_bof.errors import MapError
from slam_bof.store import MapStore, choose_component


@pytest.fixture
def store(tmp_path: Path):
    """Keyframes 0 and 1 in the first component, 2 to 4 in the second."""
    with MapStore.create(tmp_path / "map.db") as store:
        for id_ in range(5):
            save(store, replace(make_keyframe(id_), segment=int(id_ >= 2)))
        yield store


def test_the_largest_is_taken_though_it_is_not_the_first(
    store: MapStore, caplog: pytest.LogCaptureFixture
) -> None:
    assert choose_component(store).nonzero()[0].tolist() == [2, 3, 4]
    assert "2 components that no loop has joined; taking the largest, component 1, with 3 of 5" in (
        caplog.text
    )


def test_one_that_is_named_is_taken_without_a_warning(
    store: MapStore, caplog: pytest.LogCaptureFixture
) -> None:
    assert choose_component(store, 0).nonzero()[0].tolist() == [0, 1]
    assert not caplog.text
    with pytest.raises(MapError, match="found no component 2, expected one of: 0, 1"):
        choose_component(store, 2)


def test_another_session_has_none(store: MapStore) -> None:
    assert not choose_component(store, session=1).any()
