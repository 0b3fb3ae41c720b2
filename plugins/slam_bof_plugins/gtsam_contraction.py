"""Contraction of nodes of a pose graph: a node becomes one with its anchor.

The reduced pose graph of Johannsson et al. (ICRA 2013): where a place is known well enough, its
keyframes are not added for ever. A node that goes is taken to be fixed to its anchor where the map
has the two now, and what was measured between it and other nodes is composed with that pose and
becomes an edge of the anchor. Odometry stays a tree. Other edges between the same two nodes are
averaged, and a node keeps not more of them than a given number.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import gtsam
import numpy as np

from slam_bof.types import Array
from slam_bof_plugins.gtsam_selection import Edge, Noisy, Step

__all__ = ["Attachment", "Contraction", "attach"]

Noise = gtsam.noiseModel.Gaussian


class Attachment(NamedTuple):
    """The anchor of a node that is removed, and the node's pose and information relative to it."""

    anchor: int
    T_anchor_node: gtsam.Pose3
    information: Array


def attach(
    estimate: gtsam.Values, anchors: Mapping[int, int], loops: Iterable[Noisy], sigma: float
) -> dict[int, Attachment]:
    """Return where each node goes, as sure as the loop between it and its anchor is.

    Without such a loop it is as sure as an average one, of standard deviation ``sigma``.
    """
    known: dict[int, Array] = {}
    for edge, noise in loops:
        if anchors.get(edge.query) == edge.match:
            known[edge.query] = noise.information()
    return {
        node: Attachment(
            anchor,
            estimate.atPose3(anchor).between(estimate.atPose3(node)),
            known.get(node, np.eye(6) / sigma**2),
        )
        for node, anchor in anchors.items()
    }


class Contraction:
    """Collects the edges that nodes leave behind as they go to their anchors.

    Parameters
    ----------
    gone
        The nodes that go.
    settled
        The edges that were left behind before.
    max_edges
        Largest number of settled edges of a node.
    max_trace
        Largest trace of the information of a settled edge: the errors of edges that are averaged
        are not independent.
    """

    def __init__(
        self,
        gone: Mapping[int, Attachment],
        settled: Iterable[Noisy],
        *,
        max_edges: int,
        max_trace: float,
    ) -> None:
        self._gone = gone
        self._max_edges = max_edges
        self._max_trace = max_trace
        self._settled: dict[frozenset[int], Noisy] = {}
        self._n_edges: Counter[int] = Counter()
        for edge, noise in settled:
            self._add(*self._composed(edge, noise))

    @property
    def settled(self) -> list[Noisy]:
        """The edges that nodes have left behind, at most one between two nodes."""
        return list(self._settled.values())

    def touches(self, edge: Edge) -> bool:
        """Return whether a node of an edge goes."""
        return edge.match in self._gone or edge.query in self._gone

    def steps(self, steps: Iterable[Step], estimate: gtsam.Values) -> dict[int, Step]:
        """Return the steps to the nodes that stay, from where the nodes before them go.

        The step to a node that goes becomes an edge of its anchor, whatever there is room for:
        without it a large loop might fall open.
        """
        staying: dict[int, Step] = {}
        ending: list[Noisy] = []
        for step in steps:
            edge, noise = self._composed(Edge(*step[:3]), step.noise)
            if step.node not in self._gone:
                if step.is_lost:
                    between = estimate.atPose3(edge.match).between(estimate.atPose3(edge.query))
                    edge, noise = edge._replace(measured=between), step.noise
                staying[step.node] = Step(*edge, noise, step.is_lost)
            elif not step.is_lost:
                ending.append((edge, noise))
        linked = {frozenset(step[:2]) for step in staying.values()} | self._settled.keys()
        for edge, noise in ending:
            if frozenset(edge[:2]) not in linked:
                self._add(edge, noise)
        return staying

    def compose(self, edge: Edge, noise: Noise) -> None:
        """Add an edge between where its nodes go, if there is room, or average it with another."""
        edge, noise = self._composed(edge, noise)
        if frozenset(edge[:2]) in self._settled or all(
            self._n_edges[node] < self._max_edges for node in edge[:2]
        ):
            self._add(edge, noise)

    def _add(self, edge: Edge, noise: Noise) -> None:
        pair = frozenset(edge[:2])
        if len(pair) < 2:
            return
        if pair in self._settled:
            self._settled[pair] = _mean(self._settled[pair], (edge, noise), self._max_trace)
        else:
            self._settled[pair] = edge, noise
            self._n_edges.update(pair)

    def _composed(self, edge: Edge, noise: Noise) -> Noisy:
        """Return the edge between where its nodes go."""
        if not self.touches(edge):
            return edge, noise
        match, query, T = edge
        information = noise.information()
        if match in self._gone:
            match, T_anchor_match, of_match = self._gone[match]
            information = _in_series(of_match, T, information)
            T = T_anchor_match.compose(T)
        if query in self._gone:
            query, T_anchor_query, of_query = self._gone[query]
            T_query_anchor = T_anchor_query.inverse()
            of_query = _moved(of_query, T_query_anchor)
            information = _in_series(information, T_query_anchor, of_query)
            T = T.compose(T_query_anchor)
        return Edge(match, query, T), Noise.Information(information)


def _moved(information: Array, T_b_c: gtsam.Pose3) -> Array:
    """Return the information of ``T_a_b`` as that of a tangent at c, which is fixed to b."""
    adjoint = T_b_c.AdjointMap()
    return np.asarray(adjoint.T @ information @ adjoint)


def _in_series(of_first: Array, T_second: gtsam.Pose3, of_second: Array) -> Array:
    """Return the information of two poses composed: covariances add up.

    The second may leave directions open, which have no covariance.
    """
    first = _moved(of_first, T_second)
    both = of_second - of_second @ np.linalg.solve(first + of_second, of_second)
    return np.asarray((both + both.T) / 2)


def _mean(first: Noisy, second: Noisy, max_trace: float) -> Noisy:
    """Return the mean of two edges between the same nodes, weighted by information."""
    edge, information = first[0], first[1].information()
    T, weight = second[0].measured, second[1].information()
    if second[0].match != edge.match:
        T = T.inverse()
        weight = _moved(weight, T)
    total = information + weight
    apart = gtsam.Pose3.Logmap(edge.measured.between(T))
    step = np.linalg.lstsq(total, weight @ apart, rcond=None)[0]
    total *= min(1.0, max_trace / np.trace(total))
    measured = edge.measured.compose(gtsam.Pose3.Expmap(step))
    return edge._replace(measured=measured), Noise.Information((total + total.T) / 2)
