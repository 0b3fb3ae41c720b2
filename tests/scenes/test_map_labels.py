from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_bof.geometry import se3
from slam_bof.scenes import label_map
from slam_bof.types import Bag, Keyframe, Scene

CLASSES = ("bath", "kitchen")
BAG = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def walk(labels: list[str | None]) -> tuple[list[Keyframe], np.ndarray]:
    keyframes = []
    for k, label in enumerate(labels):
        p = np.array([0.8, 0.2] if label == "bath" else [0.2, 0.8])
        scene = None if label is None else Scene(label, 0.8, CLASSES, p)
        keyframes.append(Keyframe(k, 5 * k, k / 2, np.eye(4), BAG, scene))
    return keyframes, np.array([se3.pose(np.eye(3), [0.3 * k, 0, 0]) for k in range(len(labels))])


def test_a_wrong_label_is_corrected_and_rooms_are_found():
    keyframes, poses = walk(["bath"] * 4 + ["kitchen"] + ["bath"] * 4 + ["kitchen"] * 9)
    scenes, regions = label_map(keyframes, poses)
    assert [scene.label for scene in scenes] == ["bath"] * 9 + ["kitchen"] * 9
    assert [region.label for region in regions] == ["bath", "kitchen"]
    # Where the two meet, neighbours of either side vote.
    assert set(range(7)) <= set(regions[0].keyframe_ids) <= set(range(11))


def test_keyframes_without_label_stay_without():
    keyframes, poses = walk(["bath", None, "bath", "bath"])
    scenes, (region,) = label_map(keyframes, poses)
    assert [scene and scene.label for scene in scenes] == ["bath", None, "bath", "bath"]
    assert region.keyframe_ids == (0, 2, 3)


def test_a_map_without_labels_has_no_rooms():
    assert label_map(*walk([None, None])) == ([None, None], [])
    assert label_map([], np.empty((0, 4, 4))) == ([], [])


def test_culled_keyframes_are_in_the_room_of_their_anchor():
    """The second half of the walk stands where the first stood, and was culled."""
    keyframes, poses = walk(["bath"] * 5 + ["kitchen"] * 5)
    again = [replace(k, id=k.id + 10, stamp_s=k.stamp_s + 60.0) for k in keyframes]
    anchors = np.tile(np.arange(10), 2)
    both = [*keyframes, *again]
    scenes, rooms = label_map(both, np.concatenate([poses, poses]), anchors=anchors)
    _, expected = label_map(keyframes, poses)
    assert len(scenes) == 20
    assert [room.label for room in rooms] == [room.label for room in expected]
    for room, alone in zip(rooms, expected, strict=True):
        ids = np.array(alone.keyframe_ids)
        assert room.keyframe_ids == (*ids.tolist(), *(ids + 10).tolist())
        assert room.center_m == alone.center_m
