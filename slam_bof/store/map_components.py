"""Which component of the pose graph each keyframe of a saved map is in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.slam import MapComponents
from slam_bof.store.map_store import MapStore

__all__ = ["components_of"]


def components_of(store: MapStore) -> NDArray[np.int64]:
    """Return the component (K,) of each keyframe, as the loops of the graph connect them."""
    components = MapComponents()
    for keyframe in store.keyframes():
        components.add(keyframe.segment)
    for loop in store.loops():
        components.join(loop.query_id, loop.match_id)
    return components.of_keyframes()
