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
the next, beyond the noise of their edges. So does that of views, but then it is the edges that move
less steadily from step to step. A slow drift that always goes the same way is no random walk and
hardly shows in short edges; it shows in those between keyframes that are far apart.

Some edges are wrong, so squares are taken by their median, and products of few count no more than
a multiple of the median.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Array, Pose

__all__ = ["MIN_RELATIVE_SIGMA_LONG", "OdometryNoise"]

MIN_TRIPLES, MIN_STEPS = 10, 10
"""With fewer of either, nothing is known yet."""
MAX_TRIPLES = 4
"""Number of triples, the newest ones, that an edge is taken in."""
LONG = 10
"""Edges over more than this number of keyframes show a slow drift."""
LONG_FACTOR = 2.5
"""Long edges are less precise than others by no more than this factor, since views differ more."""
MIN_RELATIVE_SIGMA = 0.1
"""A step is believed no more than this."""
MIN_RELATIVE_SIGMA_LONG, MIN_LONG = 0.7, 10
"""Nor more than this where as many long edges can mend a slow drift that is less than their noise,
which therefore does not show."""
UNIT_SHAPE: Array = np.eye(6)
N_KEPT = 1000
"""Number of closures, steps and long edges, the newest ones, of which the noise is learnt."""
MEDIAN_SQUARE = 2.366
"""Median of the sum of squares of three independent variables of variance 1."""
OUTLIER = 25.0
"""Products greater than their median by this factor count as that much."""
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
        self._triples: list[tuple[int, ...]] = []
        self._edges: dict[tuple[int, int], tuple[Pose, Array]] = {}
        # Sums of squares over the three axes, of rotation and of translation, each (2,):
        self._walks: deque[tuple[int, Array]] = deque(maxlen=N_KEPT)  # with keyframes passed
        self._closures: deque[Array] = deque(maxlen=N_KEPT)
        self._off_steps: deque[Array] = deque(maxlen=N_KEPT)
        self._steps: dict[int, Array] = {}  # (2, 6) to a keyframe, by odometry and by the edge
        self._unsteadiness: deque[Array] = deque(maxlen=N_KEPT)  # of edges less odometry's
        self._off_long: deque[tuple[int, Array]] = deque(maxlen=N_KEPT)  # with keyframes passed
        self._whitened: deque[float] = deque(maxlen=N_KEPT)
        self._step_sigmas: Array | None = None
        self._drift_sigmas = np.zeros(2)

    def add_keyframe(self, keyframe_id: int, T_odom_camera: Pose) -> None:
        """Add a keyframe by its pose (4, 4) from odometry."""
        self.T_odom_camera[keyframe_id] = T_odom_camera
        self._neighbours[keyframe_id] = {}

    def add_edge(
        self, match_id: int, query_id: int, T_match_query: Pose, shape: Array = UNIT_SHAPE
    ) -> None:
        """Add an edge that holds all directions, for the next ``learn``.

        One of an unknown keyframe says nothing.

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
            self._triples.append(tuple(sorted((match_id, query_id, other))))
        off, n_passed = _squares(self._neighbours[match_id][query_id]), query_id - match_id
        if n_passed == 1:
            self._off_steps.append(off)
            steps = se3.log(np.stack([by_odometry, T_match_query]))
            before = self._steps.pop(match_id, None)
            self._steps[query_id] = steps
            if before is not None:
                changes = _squares(steps - before)
                self._unsteadiness.append(changes[1] - changes[0])
        if n_passed > LONG:
            self._off_long.append((n_passed, off))

    def learn(self) -> None:
        """Learn from the edges that were added."""
        if self._triples:
            self._learn_triples()
        if len(self._closures) < MIN_TRIPLES or len(self._off_steps) < MIN_STEPS:
            return
        edge = np.maximum(_variance(self._closures) / 3.0, TINY)  # along an axis
        n_passed, walks = map(np.array, zip(*self._walks, strict=True))
        walks = walks / n_passed[:, None]
        most = OUTLIER * np.median(np.abs(walks), axis=0)
        walk = np.average(np.clip(walks, -most, most), axis=0, weights=n_passed) / 3.0
        step = np.maximum(_variance(self._off_steps) - edge, 0.0)
        if len(self._unsteadiness) >= MIN_STEPS:
            unsteadiness = np.median(list(self._unsteadiness), axis=0)
            is_of_views = unsteadiness > np.median(list(self._off_steps), axis=0)
            step = np.where(is_of_views, 0.0, step)
        self._step_sigmas = np.sqrt((np.maximum(walk, 0.0) + step) / edge)
        if self._off_long:
            n_passed, off = map(np.array, zip(*self._off_long, strict=True))
            beyond = np.maximum(off / MEDIAN_SQUARE - LONG_FACTOR**2 * edge, 0.0)
            self._drift_sigmas = np.sqrt(np.median(beyond / n_passed[:, None], axis=0) / edge)

    def forget(self, keyframe_id: int) -> None:
        """Forget a keyframe that gets no further edges; what was learnt from it stays."""
        self.T_odom_camera.pop(keyframe_id, None)
        self._steps.pop(keyframe_id, None)
        for other in self._neighbours.pop(keyframe_id, {}):
            del self._neighbours[other][keyframe_id]
            del self._edges[min(other, keyframe_id), max(other, keyframe_id)]

    def relative_sigmas(self, share: Array | float = 1.0) -> Array | None:
        """Return the standard deviation of a step of odometry, as a multiple of that of an edge.

        Parameters
        ----------
        share
            (2,) of rotation and of translation: the share of the differences between odometry and
            edges that is known to be odometry's.

        Returns
        -------
        (2,), of rotation and of translation; or None as long as too few edges are known.
        """
        step = self.step_sigmas()
        if step is None:
            return None
        step = share * step
        has_long = len(self._off_long) >= MIN_LONG
        least = MIN_RELATIVE_SIGMA_LONG if has_long else MIN_RELATIVE_SIGMA
        return np.asarray(np.maximum(np.maximum(step, least), self._drift_sigmas))

    def step_sigmas(self) -> Array | None:
        """Return the same (2,) of odometry without slow drift, or None."""
        return None if self.is_given else self._step_sigmas

    def usual_step(self) -> Array:
        """Return by how much (2,) odometry usually differs from an edge of one step, rad and m.

        It is infinite as long as there is no such edge.
        """
        if not self._off_steps:
            return np.full(2, np.inf)
        return np.asarray(np.sqrt(np.median(list(self._off_steps), axis=0)))

    @property
    def closures(self) -> list[float]:
        """The squared Mahalanobis distances of the newest closures, by the shapes of edges."""
        return list(self._whitened)

    def _learn_triples(self) -> None:
        """Learn from the triples, in the order of time, that new edges have closed."""
        triples, self._triples = self._triples, []
        i, j, k = np.array(triples).T
        a, b, c = (
            np.array([self._neighbours[match][query] for match, query in pairs.tolist()])
            for pairs in (np.stack([i, j], 1), np.stack([j, k], 1), np.stack([i, k], 1))
        )
        (T_i_j, of_a), (T_j_k, of_b), (T_i_k, of_c) = (
            map(np.array, zip(*(self._edges[match, query] for match, query in pairs), strict=True))
            for pairs in (zip(*ends, strict=True) for ends in ((i, j), (j, k), (i, k)))
        )
        T_k_j = np.array([self._step(last, middle) for _, middle, last in triples])
        a = (se3.adjoint(T_k_j) @ a[..., None])[..., 0]  # as a motion of the last keyframe
        walk = _products(a + b, c) + 2.0 * _products(a, b)
        closure = se3.log(se3.inverse(T_i_k) @ T_i_j @ T_j_k)
        carried = se3.adjoint(se3.inverse(T_j_k))
        shape = carried @ of_a @ np.swapaxes(carried, 1, 2) + of_b + of_c
        whitened = closure[:, None] @ np.linalg.solve(shape, closure[..., None])
        self._whitened.extend(whitened[:, 0, 0].tolist())
        self._walks.extend(zip((k - i).tolist(), walk, strict=True))
        self._closures.extend(_squares(closure))

    def _step(self, a: int, b: int) -> Pose:
        """Return the pose (4, 4) of keyframe b in the camera of keyframe a."""
        return se3.inverse(self.T_odom_camera[a]) @ self.T_odom_camera[b]


def _products(a: Array, b: Array) -> Array:
    """Return the dot products (..., 2) of rotations and of translations of tangents (..., 6)."""
    return np.asarray((a * b).reshape(*a.shape[:-1], 2, 3).sum(axis=-1))


def _squares(tangent: Array) -> Array:
    return _products(tangent, tangent)


def _variance(squares: Iterable[Array]) -> Array:
    """Return the variance (2,) along an axis of which there are squares (2,) of three axes."""
    return np.asarray(np.median(list(squares), axis=0) / MEDIAN_SQUARE)
