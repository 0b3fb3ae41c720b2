"""Keyframe culling: where enough keyframes show a place, later ones are removed from the map.

The reduced pose graph of Johannsson et al. (ICRA 2013), with the test of ORB-SLAM that several
others see the same: a keyframe is removed if enough older ones have its viewpoint, and geometry has
verified a loop to one of these, its anchor. It leaves the search index, the stored views and the
pose graph; its pose stays fixed to that of the anchor. Each keyframe is decided about once, when
none of its loops waits for others to agree. A keyframe that is kept then is never removed, so that
the number of keyframes depends on the size of the place, not on the time spent in it.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.types import EdgeKind, Loop, Params

__all__ = ["KeyframeCulling", "MapParams"]


class MapParams(Params):
    """When keyframes are removed from the map, so that it stops growing where it is complete."""

    cull: bool = Field(
        True,
        description="Whether keyframes that show nothing new are removed from search and from the "
        "pose graph; with bags none are.",
    )
    n_views: int = Field(
        6,
        gt=0,
        description="Number of older keyframes at the viewpoint of a keyframe from which it is "
        "removed.",
    )
    large: int = Field(
        300,
        gt=0,
        description="Number of keyframes in use from which a map is large.",
    )
    n_views_large: int = Field(
        3,
        gt=0,
        description="Number of older keyframes at the viewpoint of a keyframe from which it is "
        "removed from a large map, whose cost counts for more.",
    )
    same_m: float = Field(
        0.2,
        gt=0,
        description="Distance, in m, below which two keyframes have one viewpoint.",
    )
    same_rad: float = Field(
        0.2,
        gt=0,
        description="Angle, in rad, below which two keyframes at one viewpoint look the same way.",
    )
    every: int = Field(
        16,
        gt=0,
        description="Number of keyframes after which removable ones are looked for again; an "
        "eighth of the keyframes in use where that is more.",
    )
    max_edges: int = Field(
        12,
        gt=0,
        description="Number of edges of a keyframe up to which it inherits those of removed ones.",
    )
    max_memory_mb: float | None = Field(
        None,
        gt=0,
        description="Memory of the process, in MB, from which new keyframes are neither searched "
        "for loops nor kept to be found; null is nine tenths of the memory of the machine.",
    )


class KeyframeCulling:
    """Chooses the keyframes to cull, and their anchors.

    Parameters
    ----------
    params
        Parameters of the choice.
    window
        Number of keyframes for which a loop may wait for others to agree.
    max_distance_m, max_angle_rad
        Largest error, in the map, of the loops of a keyframe that is culled. A keyframe with a
        loop that the map contradicts is kept until the final optimisation, which weighs all loops,
        unless twice as many older ones show the same: some loops are always a little off, and
        their keyframes would be kept for ever.

    Attributes
    ----------
    undecided
        Ids of the keyframes that may still be culled, in order.
    """

    def __init__(
        self, params: MapParams, *, window: int, max_distance_m: float, max_angle_rad: float
    ) -> None:
        self.params = params
        self.undecided: list[int] = []
        self._window = window
        self._max_distance_m = max_distance_m
        self._max_angle_rad = max_angle_rad

    def choose(self, graph: MapGraph, waiting: Collection[int]) -> dict[int, int]:
        """Return the anchors by the ids of keyframes that may go now.

        ``waiting`` are the ids of keyframes whose loops are not settled yet.
        """
        # To remove some costs as much as the whole graph, so it is done less often where it grows.
        every = max(self.params.every, len(graph.in_use) // 8)
        if len(self.undecided) < self._window + every:
            return {}
        newest = len(graph.anchors) - 1
        anchors: dict[int, int] = {}
        for keyframe_id in list(self.undecided):
            if newest - keyframe_id <= self._window or keyframe_id in waiting:
                continue
            anchor = self._anchor(keyframe_id, graph, [*self.undecided, *anchors])
            self.undecided.remove(keyframe_id)
            if anchor is not None:
                anchors[keyframe_id] = anchor
        return anchors

    def _anchor(self, keyframe_id: int, graph: MapGraph, others: Sequence[int]) -> int | None:
        """Return the anchor of a keyframe, none of ``others``, or None if it is to be kept."""
        p, T_map_camera = self.params, graph.T_map_camera
        loops = [loop for loop in graph.log.of(keyframe_id) if loop.kind == EdgeKind.LOOP]
        older = graph.in_use[graph.in_use < keyframe_id]
        older = older[~np.isin(older, others)]
        components = graph.components.in_use()
        older = older[components[older] == components[keyframe_id]]
        T = se3.inverse(T_map_camera[keyframe_id]) @ T_map_camera[older]
        apart = np.linalg.norm(T[:, :3, 3], axis=1) / p.same_m
        turned = np.asarray(se3.rotation_angle(T)) / p.same_rad
        same = (apart < 1.0) & (turned < 1.0)
        n_views = p.n_views if len(graph.in_use) < p.large else p.n_views_large
        agreeing = [loop for loop in loops if not self._contradicts(loop, graph)]
        if same.sum() < (n_views if len(agreeing) == len(loops) else 2 * n_views):
            return None
        same &= np.isin(older, [loop.match_id for loop in agreeing])
        if not same.any():
            return None
        return int(older[same][(apart + turned)[same].argmin()])

    def _contradicts(self, loop: Loop, graph: MapGraph) -> bool:
        T = graph.T_map_camera
        error = se3.inverse(T[loop.match_id] @ loop.T_match_query) @ T[loop.query_id]
        return bool(
            np.linalg.norm(error[:3, 3]) > self._max_distance_m
            or se3.rotation_angle(error) > self._max_angle_rad
        )
