"""How uncertain the poses of keyframes are.

The information of an edge has the right proportions between its directions, not the right scale.
What the scale is, three keyframes with an edge between each two tell, whose closures show the noise
of edges alone (``odometry_noise``): the median of their squared Mahalanobis distances is known.

The covariance of a keyframe is the sum of those along the most certain path to it from the first
keyframe of its component. That is more than the marginal of the pose graph, in which the errors of
parallel paths average out: these are not independent, because edges of one view share its error.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.slam.graph_paths import Links
from slam_bof.slam.loop_log import LoopLog, edge_shapes
from slam_bof.slam.odometry_noise import MIN_TRIPLES, OdometryNoise
from slam_bof.types import Array, EdgeKind, Keyframe, Loop, Pose

__all__ = ["MapUncertainty", "PoseUncertainty"]

EDGE_VARIANCE = 0.01**2
"""Variance of an edge until its noise is known: the mean over the six axes, in rad^2 and m^2."""
MEDIAN_SQUARE = 5.348
"""Median of the sum of squares of six independent normal variables of variance 1."""
MIN_EDGE_VARIANCE = 1e-5**2
"""Smallest variance of an edge, where edges agree with each other but for rounding."""
VIEW_FACTOR = 1.5
"""Variance of an edge as a multiple of that which closures show: the error of a view is part of all
its edges, so that it shows in no closure."""
STEP_VARIANCE = 0.05**2
"""Variance of a step between keyframes by an odometry of unknown noise, in rad^2 and m^2."""
OPEN_VARIANCE = 10.0**2
"""Variance of a pose along directions that nothing holds, in rad^2 and m^2."""


@dataclass(frozen=True, slots=True, eq=False)
class PoseUncertainty:
    """The uncertainty of a keyframe's pose in the map, and of frames that are aligned with it.

    ``covariance`` (6, 6) is that of the tangent of its pose, rotation first, in rad^2 and m^2, and
    ``view_variances`` (2,) are those of an alignment along each axis.
    """

    keyframe: Keyframe
    covariance: Array
    view_variances: Array

    def of_frame(self, T_odom_camera: Pose, open_axes: Array) -> Array:
        """Return the covariance (6, 6) of a frame near the keyframe, translation first.

        Parameters
        ----------
        T_odom_camera
            (4, 4) pose of the frame, corrected by tracking like that of the keyframe.
        open_axes
            (6, k) directions in which nothing holds the frame.
        """
        T_frame_keyframe = se3.inverse(T_odom_camera) @ self.keyframe.T_odom_camera
        carried = se3.adjoint(T_frame_keyframe)
        covariance = carried @ self.covariance @ carried.T
        covariance += np.diag(np.repeat(self.view_variances, 3))
        covariance += OPEN_VARIANCE * open_axes @ open_axes.T
        return se3.exchange_blocks(covariance)


class MapUncertainty:
    """Takes the keyframes of a map and the edges of its log, and knows the covariance of poses.

    ``keyframes`` are those in use by id, in order.
    """

    def __init__(self, log: LoopLog) -> None:
        self._log = log
        self.keyframes: dict[int, Keyframe] = {}
        self._noise: dict[int, OdometryNoise] = {}

    @classmethod
    def of_map(cls, keyframes: Iterable[Keyframe], loops: Iterable[Loop]) -> Self:
        """Build one of all keyframes and edges of a finished map."""
        log = LoopLog()
        known = cls(log)
        for keyframe in keyframes:
            known.add_keyframe(keyframe)
        known.learn([(loop, log.append(loop)) for loop in loops])
        return known

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a keyframe."""
        self.keyframes[keyframe.id] = keyframe
        noise = self._noise.setdefault(keyframe.session, OdometryNoise())
        noise.is_given |= keyframe.step_covariance is not None
        if keyframe.T_odom_raw is not None:
            noise.add_keyframe(keyframe.id, keyframe.T_odom_raw)

    def learn(self, edges: Iterable[tuple[Loop, Array]]) -> None:
        """Learn from edges with their ``edge_shapes``, if they are of one uninterrupted track."""
        for loop, shape in edges:
            match, query = self.keyframes[loop.match_id], self.keyframes[loop.query_id]
            if match.segment == query.segment and loop.kind != EdgeKind.PARTIAL:
                self._noise[query.session].add_edge(
                    loop.match_id, loop.query_id, loop.T_match_query, shape
                )
        for noise in self._noise.values():
            noise.learn()

    def forget(self, keyframe_id: int) -> None:
        """Forget a culled keyframe; what was learnt from it stays."""
        self._noise[self.keyframes.pop(keyframe_id).session].forget(keyframe_id)

    def odometry(self, session: int) -> OdometryNoise | None:
        """Return what is known of the odometry of a session."""
        return self._noise.get(session)

    @property
    def sessions(self) -> dict[int, OdometryNoise]:
        """What is known of the odometry of each session."""
        return self._noise

    def edge_variances(self) -> Array:
        """Return the variance (2,) along an axis of a typical edge, in rad^2 and m^2."""
        spreads = self._log.edges().spreads
        typical = np.median(spreads, axis=0) / 3.0 if len(spreads) else np.ones(2)
        return np.asarray(self.edge_scale() * typical)

    def edge_scale(self) -> float:
        """Return the factor by which the covariance of an edge is its ``edge_shapes``."""
        closures = [closure for noise in self._noise.values() for closure in noise.closures]
        if len(closures) < MIN_TRIPLES:
            return EDGE_VARIANCE
        return max(VIEW_FACTOR * float(np.median(closures)) / MEDIAN_SQUARE, MIN_EDGE_VARIANCE)

    def edge_excess(self) -> float:
        """Return by how much the noise of edges exceeds what the back-end takes it for, at least 1.

        It weighs edges less that are off by more, by its robust kernel.
        """
        return max(float(np.sqrt(self.edge_scale() / EDGE_VARIANCE)), 1.0)

    def of_edges(self, loops: Sequence[Loop]) -> Array:
        """Return the covariance (L, 6, 6) of the tangent of ``T_match_query`` of each edge."""
        information = np.array([loop.information for loop in loops]).reshape(-1, 6, 6)
        return np.asarray(self.edge_scale() * edge_shapes(information))

    def newest(self, components: NDArray[np.int64], T_map_camera: Array) -> PoseUncertainty:
        """Return the uncertainty of the newest keyframe; parameters as for ``covariances``."""
        newest = len(components) - 1
        root = int(np.flatnonzero(components == components[newest])[0])
        links = self._links(len(components))
        _, before = links.paths_from(root)
        path = [newest]
        while path[-1] != root:
            path.append(int(before[path[-1]]))
        covariance = self._covariances(links, path[:-1], before, T_map_camera).sum(axis=0)
        covariance = _in_camera(covariance, T_map_camera[newest])
        return PoseUncertainty(self.keyframes[newest], covariance, self.edge_variances())

    def covariances(self, components: NDArray[np.int64], T_map_camera: Array) -> Array:
        """Return the covariance (K, 6, 6) of the pose of each keyframe in the map.

        It is that of the tangent of ``T_map_camera`` in the camera, rotation first, in rad^2 and
        m^2, relative to the first keyframe in use of its component, where it is zero; NaN for
        keyframes that were culled.

        Parameters
        ----------
        components
            (K,) the component of each keyframe, negative if it was culled.
        T_map_camera
            (K, 4, 4) poses of the keyframes.
        """
        made = np.full((len(components), 6, 6), np.nan)
        links = self._links(len(components))
        for component in np.unique(components[components >= 0]):
            ids = np.flatnonzero(components == component)
            lengths, before = links.paths_from(int(ids[0]))
            made[ids[0]] = 0.0
            others = ids[np.argsort(lengths[ids], kind="stable")][1:].tolist()
            steps = self._covariances(links, others, before, T_map_camera)
            for key, step in zip(others, steps, strict=True):
                made[key] = made[before[key]] + step
        used = np.flatnonzero(components >= 0)
        made[used] = _in_camera(made[used], T_map_camera[used])
        return made

    def _links(self, n: int) -> Links:
        """Return what connects ``n`` keyframes, by its variance along all axes together.

        The edges in use come first, then the steps from each keyframe in use to the next.
        """
        keyframes, edges = list(self.keyframes.values()), self._log.edges()
        usual = {session: 3.0 * self._step_variances(session).sum() for session in self._noise}
        steps = [
            (a.id, b.id, _step_variance(a, b, usual[b.session]))
            for a, b in pairwise(keyframes)
            if a.segment == b.segment
        ]
        columns = np.array(steps).reshape(-1, 3).T
        return Links(
            np.append(edges.match_ids, columns[0].astype(np.int64)),
            np.append(edges.query_ids, columns[1].astype(np.int64)),
            np.append(self.edge_scale() * edges.spreads.sum(axis=1), columns[2]),
            n,
        )

    def _covariances(
        self, links: Links, ids: list[int], before: NDArray[np.int32], T_map_camera: Array
    ) -> Array:
        """Return the covariance (m, 6, 6), in the map, of each keyframe from the one before it."""
        numbers = self._log.edges().numbers
        made, ends = np.zeros((len(ids), 6, 6)), np.array(ids, np.int64)
        edges: dict[int, Loop] = {}
        for row, key in enumerate(ids):
            link = links.between(int(before[key]), key)
            if link < len(numbers):
                loop = self._log[int(numbers[link])]
                edges[row], ends[row] = loop, loop.query_id
            else:
                older, newer = sorted((int(before[key]), key))
                a, b = self.keyframes[older], self.keyframes[newer]
                made[row] = _step_covariance(a, b, self._step_variances(b.session))
                ends[row] = newer
        if edges:
            made[list(edges)] = self.of_edges(list(edges.values()))
        carried = se3.adjoint(T_map_camera[ends])
        return np.asarray(carried @ made @ np.swapaxes(carried, -1, -2))

    def _step_variances(self, session: int) -> Array:
        """Return the variances (2,) along an axis of a step of odometry, as far as is known."""
        sigmas = self._noise[session].relative_sigmas()
        if sigmas is None:
            return np.full(2, STEP_VARIANCE)
        return np.asarray(sigmas**2 * self.edge_variances())


def _step_covariance(before: Keyframe, after: Keyframe, variances: Array) -> Array:
    """Return the covariance (6, 6) of the step between two keyframes, by that of a usual step."""
    if after.step_covariance is not None:
        return after.step_covariance
    return np.diag(np.repeat(variances * (after.id - before.id), 3))


def _step_variance(before: Keyframe, after: Keyframe, usual: float) -> float:
    """Return the trace of the same covariance, by that of a usual step."""
    if after.step_covariance is not None:
        return float(np.trace(after.step_covariance))
    return usual * (after.id - before.id)


def _in_camera(covariance: Array, T_map_camera: Array) -> Array:
    """Return covariances (..., 6, 6) of tangents in the map as those of tangents in the camera."""
    carried = se3.adjoint(se3.inverse(T_map_camera))
    return np.asarray(carried @ covariance @ np.swapaxes(carried, -1, -2))
