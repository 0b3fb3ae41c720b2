"""Contraction of nodes of a pose graph: an anchor inherits the edges of a removed node.

The reduced pose graph of Johannsson et al. (ICRA 2013): the graph stops growing where a place is
known well enough. The pose of a removed node in its anchor is fixed at what the map has at that
time. Each edge of the node is composed with that pose and becomes an edge of the anchor. Odometry
stays a tree. Other edges between the same two nodes are averaged, and a node inherits no more than
a given number of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import NamedTuple

import gtsam
import numpy as np

from slam_bof.types import Array
from slam_bof_plugins.gtsam_selection import Edge, Noisy, OdometryStep

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
    """Return the anchor of each node, with the information of the loop between the two.

    Without such a loop it is that of an average one, of standard deviation ``sigma``.
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
    """Collects the edges that anchors inherit from removed nodes.

    Parameters
    ----------
    removed
        The nodes that are removed.
    inherited
        The edges that were inherited before.
    max_edges
        Largest number of edges that a node inherits.
    max_trace
        Largest trace of the information of a inherited edge: the errors of edges that are averaged
        are not independent.
    """

    def __init__(
        self,
        removed: Mapping[int, Attachment],
        inherited: Iterable[Noisy],
        *,
        max_edges: int,
        max_trace: float,
    ) -> None:
        self._removed = removed
        self._max_edges = max_edges
        self._max_trace = max_trace
        self._inherited: dict[frozenset[int], Noisy] = {}
        self._n_edges: Counter[int] = Counter()
        for edge, noise in inherited:
            self._add(*self._composed(edge, noise))

    @property
    def inherited(self) -> list[Noisy]:
        """The edges that anchors have inherited, at most one between two nodes."""
        return list(self._inherited.values())

    def touches(self, edge: Edge) -> bool:
        """Return whether a node of an edge is removed."""
        return edge.match in self._removed or edge.query in self._removed

    def steps(
        self, steps: Iterable[OdometryStep], estimate: gtsam.Values
    ) -> dict[int, OdometryStep]:
        """Return the steps to the nodes that stay, from the nodes before them or their anchors.

        The anchor of a removed node inherits the step to it, however many edges it has: without
        that step a large loop might fall open.
        """
        staying: dict[int, OdometryStep] = {}
        ending: list[Noisy] = []
        for step in steps:
            edge, noise = self._composed(Edge(*step[:3]), step.noise)
            if step.node not in self._removed:
                if step.is_lost:
                    between = estimate.atPose3(edge.match).between(estimate.atPose3(edge.query))
                    edge, noise = edge._replace(measured=between), step.noise
                staying[step.node] = OdometryStep(*edge, noise, step.is_lost)
            elif not step.is_lost:
                ending.append((edge, noise))
        linked = {frozenset(step[:2]) for step in staying.values()} | self._inherited.keys()
        for edge, noise in ending:
            if frozenset(edge[:2]) not in linked:
                self._add(edge, noise)
        return staying

    def compose(self, edge: Edge, noise: Noise) -> None:
        """Add an edge, or average it with one that is there, unless a node has inherited enough."""
        edge, noise = self._composed(edge, noise)
        if frozenset(edge[:2]) in self._inherited or all(
            self._n_edges[node] < self._max_edges for node in edge[:2]
        ):
            self._add(edge, noise)

    def _add(self, edge: Edge, noise: Noise) -> None:
        pair = frozenset(edge[:2])
        if len(pair) < 2:
            return
        if pair in self._inherited:
            self._inherited[pair] = _mean(self._inherited[pair], (edge, noise), self._max_trace)
        else:
            self._inherited[pair] = edge, noise
            self._n_edges.update(pair)

    def _composed(self, edge: Edge, noise: Noise) -> Noisy:
        """Return the edge between the anchors of its nodes; a node that stays is its own."""
        if not self.touches(edge):
            return edge, noise
        match, query, T = edge
        information = noise.information()
        if match in self._removed:
            match, T_anchor_match, of_match = self._removed[match]
            information = _in_series(of_match, T, information)
            T = T_anchor_match.compose(T)
        if query in self._removed:
            query, T_anchor_query, of_query = self._removed[query]
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
