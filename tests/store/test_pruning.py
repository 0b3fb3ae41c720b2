"""Which keyframes of a map are redundant."""

import resource
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from saved_maps import make_keyframe, save

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.store import (
    MapStore,
    SessionResult,
    check_map,
    find_redundant_keyframes,
    prune_map,
)


def test_a_keyframe_is_redundant_near_an_older_one_that_is_kept(tmp_path: Path) -> None:
    x_m = [0.0, 0.15, 0.25, 0.1, 0.1]
    turns = [0.0, 0.0, 0.0, 0.5, 0.0]
    segments = [0, 0, 0, 0, 1]
    poses = np.array([se3.exp([0.0, turn, 0.0, 0.0, 0.0, 0.0]) for turn in turns])
    poses[:, 0, 3] = x_m
    with MapStore.create(tmp_path / "map.db") as store:
        for id_, segment in enumerate(segments):
            save(store, replace(make_keyframe(id_), segment=segment))
        store.finish(0, SessionResult([], poses, [None] * 5, []))
        found = find_redundant_keyframes(store, distance_m=0.2, angle_rad=0.3)
        assert found == [1], "2 is near 1 only, 3 is turned away, 4 is of another component"
        assert find_redundant_keyframes(store, distance_m=0.2, angle_rad=0.6) == [1, 3]
        assert find_redundant_keyframes(store, distance_m=0.3, angle_rad=0.3) == [1, 2]


def test_what_is_done_is_said_where_the_file_cannot_be_made_smaller(tmp_path: Path) -> None:
    path = tmp_path / "map.db"
    with MapStore.create(path) as store:
        for id_ in range(20):
            save(store, make_keyframe(id_))
        store.finish(0, SessionResult([], np.tile(np.eye(4), (20, 1, 1)), [None] * 20, []))
    before = resource.getrlimit(resource.RLIMIT_FSIZE)

    def choose(store: MapStore) -> list[int]:
        """Leave room for what pruning writes, but not for the file to be written once more."""
        resource.setrlimit(resource.RLIMIT_FSIZE, (int(1.4 * path.stat().st_size), before[1]))
        return [3, 5]

    try:
        with pytest.raises(MapError, match="2 of 20 keyframes are dropped all the same"):
            prune_map(path, choose)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert check_map(path) == []
    with MapStore.open(path) as store:
        assert len(store.keyframes()) == 18
