"""The pose graph, and which components it holds together."""

from __future__ import annotations

import itertools
from collections.abc import Iterable

import numpy as np

from slam_bof.geometry import se3
from slam_bof.ports import Backend
from slam_bof.slam.components import MapComponents
from slam_bof.slam.odometry_noise import OdometryNoise
from slam_bof.types import Array, EdgeKind, Keyframe, Loop

__all__ = ["MapGraph"]

MAX_RELATIVE_SIGMA = 2.0
"""Steps by odometry replace those by tracking if they are not less precise than an edge by more
than this factor."""


class MapGraph:
    """Takes keyframes and loops in the order they come; joins components that loops join.

    Steps from keyframe to keyframe are those of tracking. If odometry turns out to be as precise as
    the edges between keyframes, they become those of odometry in the final optimisation.
    """

    def __init__(self, backend: Backend) -> None:
        self.backend = backend
        self.components = MapComponents()
        self.loops: list[Loop] = []
        self.left_out: list[Loop] = []
        self._added: list[Loop] = []
        self._keyframes: list[Keyframe] = []
        self._noise: dict[int, OdometryNoise] = {}

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node where odometry has it from the one before."""
        self.backend.add_keyframe(keyframe)
        self.components.add(keyframe.segment)
        self._keyframes.append(keyframe)
        if keyframe.T_odom_raw is not None:
            noise = self._noise.setdefault(keyframe.session, OdometryNoise())
            noise.add_keyframe(keyframe.id, keyframe.T_odom_raw)

    def add_loops(self, loops: Iterable[Loop]) -> None:
        """Add the edges that came with the newest keyframe, and bring the map up to date."""
        for loop in loops:
            self._join(loop)
            self.backend.add_loop(loop)
            self.loops.append(loop)
            self._added.append(loop)
            self._learn(loop)
        self.backend.update()

    def optimize(self) -> None:
        """Optimise all of it; loops that contradict the rest move to those left out."""
        if self._added:
            self._choose_steps()
            kept = self.backend.optimize() >= 0.5
            self.loops = list(itertools.compress(self._added, kept))
            self.left_out = list(itertools.compress(self._added, ~kept))

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""
        return self.backend.poses()

    def _learn(self, loop: Loop) -> None:
        """Learn how precise odometry is from an edge of one uninterrupted track."""
        match, query = self._keyframes[loop.match_id], self._keyframes[loop.query_id]
        if match.segment == query.segment and loop.kind != EdgeKind.PARTIAL:
            noise = self._noise.get(query.session)
            if noise is not None:
                noise.add_edge(loop.match_id, loop.query_id, loop.T_match_query)

    def _choose_steps(self) -> None:
        """Let the steps of each session be those of odometry if it is precise, or of tracking."""
        for before, keyframe in itertools.pairwise(self._keyframes):
            if before.segment != keyframe.segment or keyframe.step_covariance is not None:
                continue
            noise = self._noise.get(keyframe.session)
            sigmas = None if noise is None else noise.relative_sigmas()
            if noise is None or sigmas is None or sigmas.max() > MAX_RELATIVE_SIGMA:
                step = se3.inverse(before.T_odom_camera) @ keyframe.T_odom_camera
                self.backend.set_step(keyframe.id, step, None)
            else:
                self.backend.set_step(keyframe.id, noise.step(before.id, keyframe.id), sigmas)

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
