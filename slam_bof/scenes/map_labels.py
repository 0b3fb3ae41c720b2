"""Scenes of a finished map: a smoothed label for each keyframe, and rooms."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof.scenes.hmm_filter import SceneFilterParams
from slam_bof.scenes.hmm_smoother import smooth
from slam_bof.scenes.room_segmentation import MapRoom, RoomSegmentationParams, segment_rooms
from slam_bof.types import Array, Keyframe, Scene

__all__ = ["label_map"]


def label_map(
    keyframes: Sequence[Keyframe],
    T_map_camera: Array,
    labels: SceneFilterParams | None = None,
    rooms: RoomSegmentationParams | None = None,
    *,
    components: ArrayLike | None = None,
    anchors: NDArray[np.integer[Any]] | None = None,
) -> tuple[list[Scene | None], list[MapRoom]]:
    """Smooth the labels of keyframes over the whole trajectory, and segment the map into rooms.

    Parameters
    ----------
    keyframes, T_map_camera
        K keyframes in the order of time, and their poses (K, 4, 4).
    labels, rooms
        Parameters of the smoothing and of the segmentation.
    components
        (K,) component of the pose graph of each keyframe; by default all are in one.

    anchors
        (K,) the id of each keyframe, or that of its anchor if it was culled. Culled keyframes are
        in the room of their anchor. By default none was culled.

    Returns
    -------
    scenes : list of Scene or None
        (K,) the smoothed labels; None for a keyframe without a label of its own.
    rooms : list of MapRoom
        The rooms, in the order in which they were first entered.
    """
    T_map_camera = np.reshape(T_map_camera, (-1, 4, 4))
    positions_m = T_map_camera[:, :3, 3]
    labelled = [(k, kf, kf.scene) for k, kf in enumerate(keyframes) if kf.scene]
    ids = [k for k, *_ in labelled]
    smoothed = smooth(
        [scene for *_, scene in labelled],
        [keyframe.stamp_s for _, keyframe, _ in labelled],
        positions_m[ids],
        labels or SceneFilterParams(),
        axes=T_map_camera[ids, :3, 2],
        components=None if components is None else np.asarray(components)[ids],
        segments=[keyframe.segment for _, keyframe, _ in labelled],
        sessions=[keyframe.session for _, keyframe, _ in labelled],
    )
    scenes: list[Scene | None] = [None] * len(keyframes)
    for k, scene in zip(ids, smoothed, strict=True):
        scenes[k] = scene
    if anchors is None:
        return scenes, segment_rooms(scenes, positions_m, rooms, components=components)
    in_use = [s if anchors[k] == k else None for k, s in enumerate(scenes)]
    found = segment_rooms(in_use, positions_m, rooms, components=components)
    return scenes, [_with_culled(room, scenes, anchors) for room in found]


def _with_culled(
    room: MapRoom, scenes: Sequence[Scene | None], anchors: NDArray[np.integer[Any]]
) -> MapRoom:
    """Return a room with the keyframes whose anchors stand in it, as far as they have a label."""
    inside = np.flatnonzero(np.isin(anchors, room.keyframe_ids)).tolist()
    return replace(room, keyframe_ids=tuple(k for k in inside if scenes[k] is not None))
