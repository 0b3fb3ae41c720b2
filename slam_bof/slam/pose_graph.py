"""The pose graph and its connected components."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import Checkpoint, GrowingArray
from slam_bof.geometry import se3
from slam_bof.ports import Backend, ContractingBackend
from slam_bof.slam.components import MapComponents
from slam_bof.slam.graph_paths import Links
from slam_bof.slam.loop_log import LoopLog
from slam_bof.slam.map_uncertainty import MapUncertainty
from slam_bof.slam.odometry_noise import MIN_RELATIVE_SIGMA_LONG, OdometryNoise
from slam_bof.types import Array, Keyframe, Loop

__all__ = ["MapGraph"]

TRACKED_SIGMA = 5.0
"""Standard deviation of a step of tracking, as a multiple of that of an edge. It is large because
the edges between the same keyframes, found by the same alignment, are in the graph as well."""
UNKNOWN_SIGMA = 1.0
"""The same at the end of a sequence too short to tell: tracking has weighed odometry by frames, of
which there are many more than keyframes."""
PRECISE = MIN_RELATIVE_SIGMA_LONG
"""Odometry is precise if a step has at most this multiple of the standard deviation of an edge."""
SLIP, SLIP_PRECISE = 5.0, 20.0
"""Odometry has slipped where it differs from tracking by this multiple of the usual difference; the
second where it is precise, because then an alignment is more likely to be wrong."""
MAX_STEP_SIGMA = 2.5
"""Odometry is trusted against single views if a step has at most this multiple of the standard
deviation of an edge."""


class MapGraph:
    """Adds keyframes and loops to the back-end in order, and joins components that loops connect.

    Steps from keyframe to keyframe are those of tracking. Once it is known how precise odometry
    is beside the edges between keyframes, they become means of odometry and tracking, weighted by
    that, in the final optimisation. If that does not become known, they count like edges there.
    ``is_tracked`` is whether tracking has weighed odometry against alignment, which then tells of
    odometry as well.

    Attributes
    ----------
    backend
        Holds the nodes and edges in use.
    components
        The component of each keyframe.
    log
        All edges that ever entered the graph.
    uncertainty
        The noise of edges and of odometry, and the covariance of keyframes.
    in_use
        Ids (n,) of the keyframes that were not culled, in order.
    """

    def __init__(self, backend: Backend, *, is_tracked: bool = False) -> None:
        self.backend = backend
        self._is_tracked = is_tracked
        self.components = MapComponents()
        self.log = LoopLog()
        self.uncertainty = MapUncertainty(self.log)
        self.in_use: NDArray[np.int64] = np.empty(0, np.int64)
        self._left_out: set[int] = set()
        self._T_map_camera = GrowingArray((4, 4), np.float64)
        self._anchors = GrowingArray((), np.int64)
        self._T_anchor_keyframe = GrowingArray((4, 4), np.float64)
        self._travelled_m = GrowingArray((), np.float64)

    @property
    def loops(self) -> list[Loop]:
        """The edges, but for those left out. Edges of culled keyframes have no information."""
        return [loop for k, loop in enumerate(self.log) if k not in self._left_out]

    @property
    def left_out(self) -> list[Loop]:
        """The edges that the last ``optimize`` left out, because they contradict the others."""
        return [self.log[k] for k in sorted(self._left_out)]

    @property
    def can_cull(self) -> bool:
        """Whether the back-end can contract nodes."""
        return isinstance(self.backend, ContractingBackend)

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node where odometry has it from the one before."""
        self.backend.add_keyframe(keyframe)
        self.components.add(keyframe.segment)
        self.uncertainty.add_keyframe(keyframe)
        self.in_use = np.append(self.in_use, keyframe.id)
        self._T_map_camera.append(np.eye(4))
        self._anchors.append(keyframe.id)
        self._T_anchor_keyframe.append(np.eye(4))
        self._refresh()
        self._travelled_m.append(self._travelled())

    def add_loops(self, loops: Iterable[Loop]) -> None:
        """Add the edges that came with the newest keyframe, and bring the map up to date."""
        edges = []
        for loop in loops:
            self._join(loop)
            self.backend.add_loop(loop)
            edges.append((loop, self.log.append(loop)))
        self.uncertainty.learn(edges)
        self.backend.update()
        self._refresh()

    def cull(self, anchors: Mapping[int, int], max_edges: int) -> None:
        """Contract keyframes into their anchors (values), which stay; their poses follow these.

        ``max_edges`` is the number of edges of a keyframe up to which it inherits those of others.
        """
        culled = list(anchors)
        if not culled:
            return
        assert isinstance(self.backend, ContractingBackend)
        self._T_anchor_keyframe.put(culled, self.backend.contract(anchors, max_edges))
        self._anchors.put(culled, list(anchors.values()))
        self.components.cull(culled)
        self.log.cull(culled)
        for keyframe_id in culled:
            self.uncertainty.forget(keyframe_id)
        self.in_use = self.in_use[~np.isin(self.in_use, culled)]
        self._refresh()

    def optimize(self) -> None:
        """Optimise all of it; loops that contradict the rest move to those left out."""
        if len(self.log):
            self._choose_odometry()
            self._left_out = set(np.flatnonzero(self.backend.optimize() < 0.5).tolist())
            self._refresh()

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""
        poses = self._T_map_camera.rows.copy()
        culled = np.flatnonzero(self.components.in_use() < 0)
        anchors = poses[self._anchors.rows[culled]]
        poses[culled] = anchors @ self._T_anchor_keyframe.rows[culled]
        return poses

    @property
    def T_map_camera(self) -> Array:
        """The poses (K, 4, 4) of keyframes in use by their ids; those of others are outdated."""
        return self._T_map_camera.rows

    def shortest_paths_m(self) -> Array:
        """Return the length (K,), in m, of the shortest path from each keyframe to the newest.

        Paths lead along the steps between keyframes in use and along loops. Over so far the map may
        have drifted: where a loop has closed a circle, less than the camera has travelled since.
        A step over which odometry was lost has no length. Culled keyframes are infinitely far.
        """
        travelled_m, ids = self._travelled_m.rows, self.in_use
        edges = self.log.edges()
        starts: NDArray[np.int64] = np.append(ids[:-1], edges.match_ids)
        stops: NDArray[np.int64] = np.append(ids[1:], edges.query_ids)
        lengths_m = np.append(np.diff(travelled_m[ids]), edges.lengths_m)
        n = len(travelled_m)
        return Links(starts, stops, lengths_m, n).paths_from(n - 1)[0]

    def covariances(self) -> Array:
        """Return the covariance (K, 6, 6) of each keyframe; see ``MapUncertainty.covariances``.

        That of a culled keyframe is that of its anchor, to which its pose is fixed, and of the
        edge by which it is.
        """
        made = self.uncertainty.covariances(self.components.in_use(), self._T_map_camera.rows)
        culled = np.flatnonzero(self.components.in_use() < 0)
        carried = se3.adjoint(se3.inverse(self._T_anchor_keyframe.rows[culled]))
        made[culled] = carried @ made[self._anchors.rows[culled]] @ np.swapaxes(carried, -1, -2)
        made[culled] += np.diag(np.repeat(self.uncertainty.edge_variances(), 3))
        return made

    @property
    def anchors(self) -> NDArray[np.int64]:
        """The id (K,) of each keyframe, or that of its anchor if it was culled."""
        return self._anchors.rows

    def trusts_odometry(self, session: int) -> bool:
        """Return whether steps of a session's odometry are known to be about as precise as edges.

        Slow drift does not count: odometry is still better than a view that disagrees.
        """
        noise = self.uncertainty.odometry(session)
        sigmas = None if noise is None else noise.step_sigmas()
        return sigmas is not None and bool(sigmas.max() <= MAX_STEP_SIGMA)

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present graph; see ``core.Checkpoint``."""
        before = Checkpoint()
        before.save(vars(self))

        def restore() -> None:
            before.restore()
            self._refresh()

        return restore

    def _refresh(self) -> None:
        """Read the poses of keyframes in use from the back-end."""
        self._T_map_camera.rows[self.in_use] = self.backend.poses()

    def _travelled(self) -> float:
        """Return how far the camera has come at the newest keyframe."""
        components = self.components.of_keyframes()
        if len(components) == 1:
            return 0.0
        before_m = float(self._travelled_m.rows[-1])
        if components[-2] != components[-1]:
            return before_m
        step_m = np.diff(self._T_map_camera.rows[-2:, :3, 3], axis=0)
        return before_m + float(np.linalg.norm(step_m))

    def _choose_odometry(self) -> None:
        """Let the steps of each session be as precise as odometry and tracking are together."""
        for noise in self.uncertainty.sessions.values():
            keyframes = self.uncertainty.keyframes
            ids = [k for k in keyframes if k in noise.T_odom_camera]
            if not ids:
                continue
            tracked = np.array([keyframes[k].T_odom_camera for k in ids])
            by_odometry = np.array([noise.T_odom_camera[k] for k in ids])
            own = _share_of_odometry(by_odometry, tracked, noise) if self._is_tracked else 1.0
            sigmas = noise.relative_sigmas(own)
            if sigmas is not None:
                is_precise = sigmas.max() <= PRECISE
                # What is no more precise than edges drifts to one side rather than to and fro.
                sigmas = sigmas * np.maximum(sigmas / PRECISE, 1.0)
                share = sigmas**2 / (sigmas**2 + TRACKED_SIGMA**2)
                slip = (SLIP_PRECISE if is_precise else SLIP) * noise.usual_step()
                tracked = _weighted_track(by_odometry, tracked, share, slip)
                sigmas = TRACKED_SIGMA * np.sqrt(share) * self.uncertainty.edge_excess()
            elif not noise.is_given:
                sigmas = np.full(2, UNKNOWN_SIGMA)
            self.backend.set_odometry(dict(zip(ids, tracked, strict=True)), sigmas)

    def _join(self, loop: Loop) -> None:
        """Where the loop is between two components, carry the younger to the older."""
        components = self.components.in_use()
        match, query = components[loop.match_id], components[loop.query_id]
        if match == query:
            return
        T_map_camera = self._T_map_camera.rows
        T_map_query = T_map_camera[loop.match_id] @ loop.T_match_query
        T = T_map_query @ se3.inverse(T_map_camera[loop.query_id])
        younger, T = (query, T) if query > match else (match, se3.inverse(T))
        self.backend.move(np.flatnonzero(components == younger), T)
        self.components.join(loop.match_id, loop.query_id)
        self._refresh()


def _share_of_odometry(by_odometry: Array, tracked: Array, noise: OdometryNoise) -> Array:
    """Return the share (2,) of the differences between odometry and edges that is odometry's.

    For rotation and for translation. Tracking weighs odometry against alignment frame by frame, and
    so by many more differences than there are edges: its steps differ from odometry's by as much as
    it has put down to odometry.
    """
    off = _step_differences(by_odometry, tracked)[1]
    if len(off) == 0:
        return np.ones(2)
    usual = np.median(np.linalg.norm(off.reshape(-1, 2, 3), axis=2), axis=0)
    return np.asarray(np.minimum(usual / np.maximum(noise.usual_step(), 1e-12), 1.0))


def _step_differences(track: Array, other: Array) -> tuple[Array, Array]:
    """Return the steps of a track (K, 4, 4), and their differences (K - 1, 6) from another's."""
    steps, others = (se3.inverse(poses[:-1]) @ poses[1:] for poses in (track, other))
    return steps, se3.log(se3.inverse(steps) @ others)


def _weighted_track(by_odometry: Array, tracked: Array, share: Array, slip: Array) -> Array:
    """Return poses (K, 4, 4) whose steps are means of those of two tracks (K, 4, 4).

    ``share`` (2,) is the weight of the second, for rotation and for translation. Where they differ
    by more than ``slip`` (2,), in rad and m, the second counts alone.
    """
    steps, off = _step_differences(by_odometry, tracked)
    slips = (np.linalg.norm(off.reshape(-1, 2, 3), axis=2) > slip).any(axis=1)
    weights = np.where(slips[:, None], 1.0, share).repeat(3, axis=1)
    steps = steps @ se3.exp(weights * off)
    return se3.nearest_pose(np.array(list(accumulate(steps, np.matmul, initial=by_odometry[0]))))
