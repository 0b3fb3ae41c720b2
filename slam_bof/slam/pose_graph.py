"""The pose graph, and which components it holds together."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from slam_bof.geometry import se3
from slam_bof.ports import Backend
from slam_bof.slam.components import MapComponents
from slam_bof.types import Array, Keyframe, Loop

__all__ = ["MapGraph"]


class MapGraph:
    """Takes keyframes and loops in the order they come; joins components that loops join."""

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self.components = MapComponents()
        self.loops: list[Loop] = []
        self.left_out: list[Loop] = []
        self._added: list[Loop] = []

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node where odometry has it from the one before."""
        self.backend.add_keyframe(keyframe)
        self.components.add(keyframe.segment)

    def add_loops(self, loops: Iterable[Loop]) -> None:
        """Add the edges that came with the newest keyframe, and bring the map up to date."""
        for loop in loops:
            self._join(loop)
            self.backend.add_loop(loop)
            self.loops.append(loop)
            self._added.append(loop)
        self.backend.update()

    def optimize(self) -> None:
        """Optimise all of it; loops that contradict the rest move to those left out."""
        if self._added:
            kept = self.backend.optimize() >= 0.5
            self.loops = list(itertools.compress(self._added, kept))
            self.left_out = list(itertools.compress(self._added, ~kept))

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""
        return self.backend.poses()

    def _join(self, loop: Loop) -> None:
        """Where the loop is between two components, carry the younger to the older."""
        components = self.components.of_keyframes()
        match, query = components[loop.match_id], components[loop.query_id]
        if match == query:
            return
        T_map_camera = self.poses()
        T_map_query = T_map_camera[loop.match_id] @ loop.T_match_query
        T = T_map_query @ se3.inverse(T_map_camera[loop.query_id])
        younger, T = (query, T) if query > match else (match, se3.inverse(T))
        self.backend.move(np.flatnonzero(components == younger), T)
        self.components.join(loop.match_id, loop.query_id)
