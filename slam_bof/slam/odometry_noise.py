"""How precise the odometry is beside alignment, learnt from the edges of the pose graph.

Odometry may be far more precise than the alignment of two noisy views, as that of a phone is, or
far less, as scan matching may be. What tells are three keyframes i, j and k with an edge between
each two. Let A, B and C be the differences between odometry and the edges i-j, j-k and i-k.

* Odometry cancels out in the closure A + B - C, which therefore shows the noise of the edges alone.
  It is computed from the edges, because A, B and C are not small where odometry slips.
* If the noise of odometry is a random walk, that of i-j is shared by A and C, and that of j-k by B
  and C; the noise of edges is not shared, and that of a view has opposite signs in A and B. So
  A C + B C + 2 A B is the variance of odometry from i to k, whatever the noise of edges and views.

Noise by which each pose of odometry is off by itself adds to the differences from one keyframe to
the next, beyond the noise of their edges. A slow drift that always goes the same way is no random
walk and hardly shows in short edges; it shows in those between keyframes that are far apart.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["OdometryNoise"]

MIN_TRIPLES, MIN_STEPS = 10, 10
"""With fewer of either, nothing is known yet."""
MAX_TRIPLES = 4
"""Number of triples, the newest ones, that an edge is taken in."""
LONG = 10
"""Edges over more than this number of keyframes show a slow drift."""
LONG_FACTOR = 2.5
"""Long edges are less precise than others by no more than this factor, since views differ more."""
MIN_RELATIVE_SIGMA = 0.1
"""A step is believed no more than this, because a few edges do not show a slow drift."""
UNIT_SHAPE: Array = np.eye(6)
MAX_CLOSURES = 1000
"""Number of closures, the newest ones, by which covariances are scaled."""
TINY = 1e-18
"""A variance of closures, in rad^2 and m^2, that is rounding."""


class OdometryNoise:
    """Takes the keyframes of an odometry, and the edges between them.

    ``T_odom_camera`` has the pose (4, 4) of each keyframe by its id. ``is_given`` is whether the
    odometry says itself how precise it is, so that this is not learnt.
    """

    def __init__(self) -> None:
        self.T_odom_camera: dict[int, Pose] = {}
        self.is_given = False
        self._neighbours: dict[int, dict[int, Array]] = {}
        self._edges: dict[tuple[int, int], tuple[Pose, Array]] = {}
        self._n_triples = self._n_steps = self._n_long = self._n_passed = 0
        # Sums of squares over the three axes, of rotation and of translation, each (2,):
        self._walk = np.zeros(2)
        self._closure = np.zeros(2)
        self._whitened: deque[float] = deque(maxlen=MAX_CLOSURES)
        self._off_step = np.zeros(2)
        self._off_long = np.zeros(2)

    def add_keyframe(self, keyframe_id: int, T_odom_camera: Pose) -> None:
        """Add a keyframe by its pose (4, 4) from odometry."""
        self.T_odom_camera[keyframe_id] = T_odom_camera
        self._neighbours[keyframe_id] = {}

    def add_edge(
        self, match_id: int, query_id: int, T_match_query: Pose, shape: Array = UNIT_SHAPE
    ) -> None:
        """Add an edge that holds all directions. One of an unknown keyframe says nothing.

        ``shape`` (6, 6) is its covariance, up to a factor that is the same for all edges.
        """
        if not {match_id, query_id} <= self.T_odom_camera.keys():
            return
        if match_id > query_id:
            carried = se3.adjoint(T_match_query)
            match_id, query_id, shape = query_id, match_id, carried @ shape @ carried.T
            T_match_query = se3.inverse(T_match_query)
        by_odometry = self._step(match_id, query_id)
        self._edges[match_id, query_id] = T_match_query, shape
        self._neighbours[match_id][query_id] = self._neighbours[query_id][match_id] = se3.log(
            se3.inverse(T_match_query) @ by_odometry
        )
        common = self._neighbours[match_id].keys() & self._neighbours[query_id].keys()
        for other in sorted(common)[-MAX_TRIPLES:]:
            self._add_triple(*sorted((match_id, query_id, other)))
        if query_id == match_id + 1:
            self._off_step = self._off_step + _squares(self._neighbours[match_id][query_id])
            self._n_steps += 1
        if query_id - match_id > LONG:
            self._off_long = self._off_long + _squares(self._neighbours[match_id][query_id])
            self._n_long += 1

    def forget(self, keyframe_id: int) -> None:
        """Forget a keyframe that gets no further edges; what was learnt from it stays."""
        self.T_odom_camera.pop(keyframe_id, None)
        for other in self._neighbours.pop(keyframe_id, {}):
            del self._neighbours[other][keyframe_id]
            del self._edges[min(other, keyframe_id), max(other, keyframe_id)]

    def relative_sigmas(self) -> Array | None:
        """Return the standard deviation of a step of odometry, as a multiple of that of an edge.

        Returns
        -------
        (2,), of rotation and of translation; or None as long as too few edges are known.
        """
        step = self.step_sigmas()
        if step is None:
            return None
        drift = self._off_long / max(self._n_long, 1) / self._edge() - LONG_FACTOR**2
        relative = np.sqrt(np.maximum(np.square(step), drift))
        return np.asarray(np.maximum(relative, MIN_RELATIVE_SIGMA))

    def step_sigmas(self) -> Array | None:
        """Return the same (2,) of odometry without slow drift, or None."""
        if self.is_given or self._n_triples < MIN_TRIPLES or self._n_steps < MIN_STEPS:
            return None
        walk = np.maximum(self._walk / self._n_passed, 0.0)
        step = np.maximum(self._off_step / self._n_steps - self._edge(), 0.0)
        return np.asarray(np.sqrt((walk + step) / self._edge()))

    @property
    def closures(self) -> list[float]:
        """The squared Mahalanobis distances of the newest closures, by the shapes of edges."""
        return list(self._whitened)

    def _edge(self) -> Array:
        """Return the variance (2,) of an edge."""
        return np.maximum(self._closure / (3 * self._n_triples), TINY)

    def _add_triple(self, i: int, j: int, k: int) -> None:
        """Learn from three keyframes, in the order of time, with an edge between each two."""
        a = _seen_from(self._step(k, j), self._neighbours[i][j])
        b, c = self._neighbours[j][k], self._neighbours[i][k]
        self._walk = self._walk + _products(a + b, c) + 2.0 * _products(a, b)
        (T_i_j, of_a), (T_j_k, of_b), (T_i_k, of_c) = (
            self._edges[pair] for pair in ((i, j), (j, k), (i, k))
        )
        closure = se3.log(se3.inverse(T_i_k) @ T_i_j @ T_j_k)
        self._closure = self._closure + _squares(closure)
        carried = se3.adjoint(se3.inverse(T_j_k))
        whole = carried @ of_a @ carried.T + of_b + of_c
        self._whitened.append(float(closure @ np.linalg.solve(whole, closure)))
        self._n_passed += k - i
        self._n_triples += 1

    def _step(self, a: int, b: int) -> Pose:
        """Return the pose (4, 4) of keyframe b in the camera of keyframe a."""
        return se3.inverse(self.T_odom_camera[a]) @ self.T_odom_camera[b]


def _seen_from(T_k_j: Pose, tangent: Array) -> Array:
    """Return a small motion (6,) of frame j as one of frame k (its adjoint)."""
    R, (x, y, z) = T_k_j[:3, :3], T_k_j[:3, 3]
    wx, wy, wz = turn = R @ tangent[:3]
    lever = [y * wz - z * wy, z * wx - x * wz, x * wy - y * wx]
    return np.concatenate([turn, R @ tangent[3:] + lever])


def _products(a: Array, b: Array) -> Array:
    """Return the dot products of two tangents (6,), of their rotations and translations: (2,)."""
    return np.asarray((a * b).reshape(2, 3).sum(axis=1))


def _squares(tangent: Array) -> Array:
    return _products(tangent, tangent)
