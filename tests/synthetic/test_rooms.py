import numpy as np
import pytest

from slam_bof.synthetic import (
    PIECES,
    ROOM_KINDS,
    distance_to_boxes,
    furnished_views,
    furniture,
    make_room,
    messy_views,
    training_views,
)
from slam_bof.synthetic.furnisher import Furnisher
from slam_bof.synthetic.walls import Opening
from slam_bof.types import INVALID_DEPTH_MM

MAKERS = [
    furniture.armchair, furniture.bathtub, furniture.bed, furniture.bin_, furniture.bookshelf,
    furniture.boxes, furniture.cabinet, furniture.chair, furniture.coat_rack,
    furniture.coffee_table, furniture.conference_set, furniture.console, furniture.counter,
    furniture.desk, furniture.dining_set, furniture.floor_lamp, furniture.fridge,
    furniture.nightstand, furniture.picture, furniture.plant, furniture.radiator,
    furniture.sconce, furniture.shoe_rack, furniture.shower, furniture.sofa, furniture.stove,
    furniture.toilet, furniture.towel_rail, furniture.tv_stand, furniture.wall_cabinet,
    furniture.wall_shelf, furniture.wardrobe, furniture.wash_basin, furniture.washing_machine,
    furniture.whiteboard,
]  # fmt: skip


@pytest.mark.parametrize("maker", MAKERS, ids=lambda maker: maker.__name__)
def test_furniture_stands_on_the_floor_before_the_wall(maker):
    low, high = np.array([maker(np.random.default_rng(i)).bounds() for i in range(5)]).swapaxes(
        0, 1
    )
    assert (low[:, 1] > -0.1).all()
    assert (low[:, 2] > -1e-9).all()
    assert (high[:, 2] < 2.45).all()
    assert (high[:, :2] - low[:, :2] < 3.4).all()
    assert (high - low > 0.02).all()


def test_there_are_at_least_six_kinds_and_they_differ():
    assert len(ROOM_KINDS) >= 6
    sizes = {len(make_room(kind, 5).mesh) for kind in ROOM_KINDS}
    assert len(sizes) == len(ROOM_KINDS)


@pytest.mark.parametrize("kind", ROOM_KINDS)
def test_rooms_are_furnished_within_their_walls_without_overlap(kind):
    room = make_room(kind, 3)
    boxes = room.boxes
    assert len(boxes) >= 6
    assert (boxes[:, 0] > -0.02).all()
    assert (boxes[:, 1] < room.size + 0.02).all()
    shared = np.minimum(boxes[:, None, 1], boxes[None, :, 1]) - np.maximum(
        boxes[:, None, 0], boxes[None, :, 0]
    )
    overlap = (shared > 0.021).all(axis=-1)
    np.fill_diagonal(overlap, False)
    # The ceiling lamp may hang over things, and is the only one placed without asking.
    lamp = boxes[:, 1, 2] > room.size[2] - 1e-6
    assert not overlap[~lamp][:, ~lamp].any()


def test_the_seed_decides_the_room():
    first, again, other = (make_room("kitchen", seed) for seed in (7, 7, 8))
    np.testing.assert_array_equal(first.mesh.triangles, again.mesh.triangles)
    assert not np.array_equal(first.size, other.size)


def test_an_unknown_kind_is_named():
    with pytest.raises(ValueError, match=r"kind must be one of bathroom.*'cellar'"):
        make_room("cellar", 0)


def test_furniture_leaves_doors_windows_and_columns_free():
    door = Opening(0, 1.5, 0.9, 0.0, 2.05, "open")
    window = Opening(2, 1.5, 1.2, 0.9, 2.1, "window")
    clear = np.array([(1.5, y, 0.0, 0.5) for y in (0.5, 1.5)])
    placer = Furnisher(3.0, 4.0, [door, window], clear, np.random.default_rng(0))
    placer.against_wall(furniture.wardrobe, n=4)
    placer.against_wall(furniture.boxes, n=40)
    placer.free_standing(furniture.coffee_table, n=5)
    boxes = placer.boxes()
    assert len(boxes) > 10
    assert distance_to_boxes(clear[:, :2], boxes[:, :, :2]).min() >= 0.5
    in_door = (boxes[:, 0, 1] < 0.7) & (boxes[:, 0, 0] < 1.9) & (boxes[:, 1, 0] > 1.1)
    assert not in_door.any()
    before_window = (boxes[:, 1, 1] > 3.9) & (boxes[:, 0, 0] < 2.0) & (boxes[:, 1, 0] > 1.0)
    assert (boxes[before_window, 1, 2] < 0.92).all()


def test_a_column_leaves_free_only_what_is_above_its_bottom():
    clear = np.array([(1.5, 1.5, 0.8, 5.0)])
    placer = Furnisher(3.0, 3.0, [], clear, np.random.default_rng(0))
    placer.against_wall(furniture.wardrobe, n=3)
    assert len(placer.boxes()) == 0
    assert placer.near(furniture.bin_, 1.5, 1.5)


@pytest.mark.parametrize("kind", ["bathroom", "office"])
def test_training_views_look_into_the_room(kind):
    frames = list(training_views(kind, 1000, 2))
    again = list(training_views(kind, 1000, 2))
    for frame, same in zip(frames, again, strict=True):
        np.testing.assert_array_equal(frame.depth, same.depth)
        seen = frame.depth[(frame.depth > 0) & (frame.depth < INVALID_DEPTH_MM)]
        assert frame.depth.shape == (480, 640)
        assert seen.size > 0.4 * frame.depth.size
        assert np.median(seen) > 700
    assert (frames[0].depth != frames[1].depth).any()


def test_messy_corridors_are_long_often_bare_and_looked_along():
    corridors = [make_room("corridor", seed, messy=True) for seed in range(12)]
    assert max(room.size[1] for room in corridors) > 12.0
    n_bare = sum(len(room.boxes) <= 1 for room in corridors)  # the lamp
    assert 3 <= n_bare <= 9
    views = [frame.depth for frame, _ in messy_views("corridor", 4, 8)]
    assert np.mean([np.percentile(depth, 95) > 5.0 for depth in views]) >= 0.5


def test_pixels_know_their_furniture():
    bed, floor = PIECES.index("bed"), 0
    seen = set()
    for seed in range(3):
        for frame, down, pieces in furnished_views("bedroom", seed, 3, messy=True):
            assert pieces.shape == frame.depth.shape
            assert np.linalg.norm(down) == pytest.approx(1.0)
            seen |= set(np.unique(pieces).tolist())
    assert {floor, bed} <= seen
    assert PIECES.index("stove") not in seen
    room = make_room("bedroom", 0)
    corners = room.mesh.triangles[room.pieces == bed].reshape(-1, 3)
    assert len(room.pieces) == len(room.mesh)
    assert corners[:, 2].min() == pytest.approx(0.0, abs=0.01)
    assert 0.4 < corners[:, 2].max() < 1.6
