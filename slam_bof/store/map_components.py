"""The components of the pose graph of a saved map, of which one at a time has common poses."""

from __future__ import annotations

import logging
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import MapError
from slam_bof.slam import MapComponents
from slam_bof.store.map_store import MapStore

__all__ = ["choose_component", "components_of", "join_rows", "largest_component"]

logger = logging.getLogger(__name__)


def components_of(store: MapStore) -> NDArray[np.int64]:
    """Return the component (K,) of each keyframe, as the loops of the graph connect them."""
    with store.snapshot():
        return join_rows(store, store.keyframe_rows())


def join_rows(store: MapStore, keyframes: Iterable[Any]) -> NDArray[np.int64]:
    """Return the component (K,) of each keyframe, given the rows of all keyframes.

    Loops are read only where there are several segments to join.
    """
    components = MapComponents()
    for row in keyframes:
        components.add(row["segment"])
    if len(components) > 1:
        for row in store.loop_rows():
            components.join(row["query_id"], row["match_id"])
    return components.of_keyframes()


def largest_component(components: NDArray[np.int64]) -> int:
    """Return the component with the most keyframes, given that of each (K,); 0 without any."""
    return int(np.bincount(components).argmax()) if len(components) else 0


def choose_component(
    store: MapStore, component: int | None = None, *, session: int | None = None
) -> NDArray[np.bool_]:
    """Return which keyframes (K,) are in a component, by default in the largest.

    With a ``session``, only its keyframes are.

    Poses of different components are not comparable: they would lie over each other. A warning
    says so where keyframes are left out.

    Raises
    ------
    MapError
        If there is no such component.
    """
    with store.snapshot():
        rows = store.keyframe_rows()
        components = join_rows(store, rows)
    wanted = np.array([session in (None, row["session"]) for row in rows], dtype=bool)
    known = np.unique(components[wanted]).tolist()
    chosen = largest_component(components[wanted]) if component is None else component
    if component is not None and component not in known:
        listed = ", ".join(map(str, known)) or "none"
        raise MapError(f"{store.path}: found no component {component}, expected one of: {listed}")
    inside = np.asarray(wanted & (components == chosen))
    if component is None and len(known) > 1:
        logger.warning(
            "%s: %d components that no loop has joined; taking the largest, component %d, with "
            "%d of %d keyframes",
            store.path,
            len(known),
            chosen,
            np.count_nonzero(inside),
            np.count_nonzero(wanted),
        )
    return inside
