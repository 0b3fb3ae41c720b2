"""Which keyframes of a map are redundant."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from saved_maps import make_keyframe, save

from slam_bof.geometry import se3
from slam_bof.store import MapStore, SessionResult, find_redundant_keyframes


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
