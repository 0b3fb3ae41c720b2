import json

import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.synthetic import Scene3D, make_corridor, make_corridor_tour, write_corridor
from slam_bof.types import Intrinsics

SMALL = Intrinsics(40, 30, 36.5, 36.5, 20.0, 15.0)


@pytest.fixture(scope="module")
def corridor():
    return make_corridor(3)


@pytest.fixture(scope="module")
def tour(corridor):
    return make_corridor_tour(corridor)


def test_one_room_looks_like_another_to_the_millimetre(corridor, tour):
    scene = Scene3D(corridor.mesh, SMALL)
    in_first_room = [T for T in tour if corridor.rooms[0].holds(*T[:2, 3])][::20]
    assert len(in_first_room) > 10
    n_alike = 0
    for T in in_first_room:
        views = []
        for bay in range(len(corridor.rooms)):
            moved = T.copy()
            moved[0, 3] += bay * corridor.pitch_m
            views.append(scene.view(moved))
        if any(view.depth_m.max() > 4.5 for view in views):
            continue  # through the door, down the hallway, to one of its ends
        n_alike += 1
        for view in views[1:]:
            different = np.abs(view.depth_m - views[0].depth_m) > 1e-3
            assert different.mean() < 0.01  # pixels on an edge
    assert n_alike > 5


def test_the_tour_sees_every_room_and_comes_back_to_all_but_the_last(corridor, tour):
    bays = [
        number
        for x, y in tour[:, :2, 3]
        for number, room in enumerate(corridor.rooms)
        if room.holds(x, y)
    ]
    order = [bay for bay, before in zip(bays, [-1, *bays], strict=False) if bay != before]
    assert order == [0, 1, 2, 1, 0]


def test_the_tour_moves_as_hands_do(tour):
    between = se3.inverse(tour[:-1]) @ tour[1:]
    assert np.linalg.norm(between[:, :3, 3], axis=1).max() < 0.04
    assert np.degrees(se3.rotation_angle(between)).max() < 2.5


def test_no_view_is_too_close_or_leaves_the_building(corridor, tour):
    scene = Scene3D(corridor.mesh, SMALL)
    for T in tour[::40]:
        view = scene.view(T)
        assert view.depth_m.min() > 0.3
        assert (view.depth_m < 4.5).mean() > 0.5


def test_a_corridor_needs_a_room():
    with pytest.raises(ValueError, match="at least 1 room, got 0"):
        make_corridor(0)


def test_a_whole_corridor_is_kept_and_an_interrupted_one_leaves_nothing(tmp_path):
    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_corridor(tmp_path, n_rooms=1, progress=interrupt)
    assert list(tmp_path.iterdir()) == []
    recipe = {"generation": 1, "kind": "corridor", "seed": 0, "n_rooms": 1}
    (tmp_path / "corridor").mkdir()
    (tmp_path / "corridor" / "recipe.json").write_text(json.dumps(recipe))
    assert write_corridor(tmp_path, n_rooms=1) == tmp_path / "corridor" / "seq-01"
