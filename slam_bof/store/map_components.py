"""Which component of the pose graph each keyframe of a saved map is in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.slam import MapParts
from slam_bof.store.map_store import MapStore

__all__ = ["parts_of"]


def parts_of(store: MapStore) -> NDArray[np.int64]:
    """Return the part of the map (K,) that each keyframe is in, by the loops of the graph."""
    parts = MapParts()
    for keyframe in store.keyframes():
        parts.add(keyframe.segment)
    for loop in store.loops():
        parts.join(loop.query_id, loop.match_id)
    return parts.of_keyframes()
