from __future__ import annotations

import numpy as np

from slam_bof.scenes import UNKNOWN_LABEL, RoomSegmentationParams
from slam_bof.scenes.room_segmentation import segment_rooms
from slam_bof.types import Scene

CLASSES = ("bath", "kitchen", "office")


def scene(label: str, probability: float = 0.8) -> Scene:
    p = np.full(3, (1 - probability) / 2)
    p[CLASSES.index(label)] = probability
    return Scene(label, probability, CLASSES, p)


def line(*x_m: float) -> np.ndarray:
    return np.array([[x, 0.0, 0.0] for x in x_m])


def test_two_rooms_of_one_kind_that_are_apart_are_two_regions():
    rooms = segment_rooms([scene("bath")] * 6, line(0, 0.5, 1, 5, 5.5, 6))
    assert [(r.id, r.label, r.keyframe_ids) for r in rooms] == [
        (0, "bath", (0, 1, 2)),
        (1, "bath", (3, 4, 5)),
    ]
    assert rooms[1].low_m == (5, 0, 0)
    assert rooms[1].high_m == (6, 0, 0)
    assert rooms[1].center_m == (5.5, 0, 0)


def test_a_room_come_back_to_is_one_region():
    labels = ["bath"] * 3 + ["office"] * 3 + ["bath"] * 3
    x_m = (0, 0.4, 0.8, 4, 4.4, 4.8, 0.1, 0.5, 0.9)
    rooms = segment_rooms([scene(label) for label in labels], line(*x_m))
    assert [r.keyframe_ids for r in rooms] == [(0, 1, 2, 6, 7, 8), (3, 4, 5)]


def test_neighbours_outvote_a_slip():
    labels = ["bath", "bath", "office", "bath", "bath"]
    (room,) = segment_rooms([scene(s) for s in labels], line(0, 0.1, 0.2, 0.3, 0.4))
    assert room.label == "bath"
    assert len(room.keyframe_ids) == 5


def test_few_keyframes_go_to_the_region_nearby_and_else_stay():
    labels = ["bath"] * 4 + ["office"] * 2
    near = RoomSegmentationParams(vote_m=0.01)
    (room,) = segment_rooms([scene(s) for s in labels], line(0, 0.5, 1, 1.5, 2.2, 2.3), near)
    assert len(room.keyframe_ids) == 6
    alone = segment_rooms([scene(s) for s in labels], line(0, 0.5, 1, 1.5, 9.2, 9.3), near)
    assert [len(r.keyframe_ids) for r in alone] == [4, 2]


def test_components_of_the_map_do_not_mix():
    rooms = segment_rooms([scene("bath")] * 6, line(*[0.0] * 6), components=[0, 0, 0, 1, 1, 1])
    assert [r.keyframe_ids for r in rooms] == [(0, 1, 2), (3, 4, 5)]


def test_what_nobody_is_sure_of_is_unknown():
    (room,) = segment_rooms([scene("bath", 0.35)] * 3, line(0, 0, 0))
    assert (room.label, round(room.probability, 6)) == (UNKNOWN_LABEL, 0.35)


def test_keyframes_without_label_or_place_are_in_none():
    found = segment_rooms(
        [scene("bath"), None, scene("bath"), scene("bath"), scene("bath")],
        line(0, 0, np.nan, 0.5, 1),
    )
    assert [r.keyframe_ids for r in found] == [(0, 3, 4)]
    assert segment_rooms([None], line(0)) == []
    assert segment_rooms([], np.empty((0, 3))) == []
