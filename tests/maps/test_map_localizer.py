"""Localising in one component of a map, and what its keyframes are called."""

import numpy as np
import pytest

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.maps import MapLocalizer, MapSession
from slam_bof.slam import config as configs
from slam_bof.store import MapStore, components_of

WITHOUT_LOOPS = ["keyframes.policy=every", "keyframes.every=1", "map.max_memory_mb=1"]


@pytest.fixture(scope="module")
def parted(walk, tmp_path_factory):
    """A map of two sessions of five and of three keyframes that no loop joins."""
    path = tmp_path_factory.mktemp("parted") / "map.db"
    for part in (walk[:5], walk[12:15]):
        config = configs.override(configs.preset("indoor"), WITHOUT_LOOPS)
        with MapSession.open(path, config=config) as session:
            for frame, T in part:
                session.closer.process(frame, T)
    with MapStore.open(path) as store:
        assert components_of(store).tolist() == [0] * 5 + [1] * 3
    return path


@pytest.mark.parametrize(
    ("component", "n_keyframes", "seen", "ids"),
    [(None, 5, 2, range(5)), (0, 5, 2, range(5)), (1, 3, 13, range(5, 8))],
)
def test_answers_are_of_one_component_and_have_the_map_s_ids(
    parted, walk, component, n_keyframes, seen, ids
):
    localizer = MapLocalizer.open(parted, component=component)
    assert (localizer.component, len(localizer)) == (component or 0, n_keyframes)
    frame, _ = walk[seen]
    answer = localizer.localize(frame)
    found = answer.localization
    assert found.is_known, found.reason
    assert found.keyframe_id == answer.keyframe.id
    assert {found.keyframe_id, *found.supporting_ids} <= set(ids)
    with MapStore.open(parted) as store:
        T_map_camera = store.map_poses()[ids.start + seen % 12]
    off = se3.inverse(T_map_camera) @ found.T_map_camera
    assert np.linalg.norm(off[:3, 3]) < 0.05


def test_a_component_that_is_not_there_is_refused(parted):
    with pytest.raises(MapError, match="found no component 7, expected one of: 0, 1"):
        MapLocalizer.open(parted, component=7)
