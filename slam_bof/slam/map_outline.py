"""What a picture of the map needs, in one small piece."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes import UNKNOWN_LABEL, MapRoom, label_map
from slam_bof.slam.config import Config
from slam_bof.types import Array, EdgeKind, Keyframe, Loop

__all__ = ["MapOutline", "outline_of"]


@dataclass(frozen=True, slots=True, eq=False)
class MapOutline:
    """The outline of a map at one time, without descriptors, depth and measurements.

    Attributes
    ----------
    stamps_s, T_map_camera, components
        Times (K,), poses (K, 4, 4) and components (K,) of the keyframes.
    labels
        (K,) the labels smoothed over the whole map; ``unknown`` without one.
    edges, is_loop
        The matched and the query keyframe (E, 2) of each edge, and whether it is a loop (E,) or of
        covisibility.
    rooms
        The rooms, in the order in which they were first entered.
    """

    stamps_s: Array
    T_map_camera: Array
    components: NDArray[np.intp]
    labels: list[str]
    edges: NDArray[np.int64]
    is_loop: NDArray[np.bool_]
    rooms: list[MapRoom]

    def __len__(self) -> int:
        """Return the number of keyframes."""
        return len(self.stamps_s)


def outline_of(
    keyframes: Sequence[Keyframe],
    T_map_camera: Array,
    loops: Sequence[Loop],
    config: Config,
    *,
    components: NDArray[np.intp],
    anchors: NDArray[np.int64],
) -> MapOutline:
    """Return the outline of a map; ``anchors`` (K,) as ``label_map`` takes them."""
    scenes, rooms = label_map(
        keyframes,
        T_map_camera,
        config.labels,
        config.rooms,
        components=components,
        anchors=anchors,
    )
    edges = [(loop.match_id, loop.query_id) for loop in loops]
    return MapOutline(
        np.array([keyframe.stamp_s for keyframe in keyframes]),
        T_map_camera,
        components,
        [scene.label if scene else UNKNOWN_LABEL for scene in scenes],
        np.array(edges, np.int64).reshape(-1, 2),
        np.array([loop.kind == EdgeKind.LOOP for loop in loops], bool),
        rooms,
    )
