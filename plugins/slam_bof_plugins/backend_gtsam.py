"""The pose graph in GTSAM: iSAM2 while frames come, Levenberg-Marquardt at the end.

Before the end all loops are weighed together, and those that contradict the rest are left out.
GTSAM's traps are kept here: Pose3's tangent is rotation first; a non-orthonormal Rot3 kills the
interpreter; one iSAM2 update after a loop has not converged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.cluster.hierarchy import DisjointSet

from slam_bof.core import Checkpoint
from slam_bof.geometry import GraphEdge, loop_information, se3, step_sigmas, write_g2o
from slam_bof.types import Array, EdgeKind, Keyframe, Loop, Params, Pose
from slam_bof_plugins.gtsam_contraction import Contraction, attach
from slam_bof_plugins.gtsam_selection import (
    LOST_SIGMA,
    ROOT_SIGMA,
    Edge,
    Node,
    Noisy,
    OdometryStep,
    SelectionParams,
    optimized,
    pose3,
    poses_of,
    weigh_loops,
)

__all__ = ["GtsamBackend", "GtsamParams"]


STEP_FLOOR = 1e-4
"""Smallest standard deviation of a step, in rad and m: smaller ones make the equations singular."""

MAX_GAIN = 10.0
"""Largest information of an edge that was averaged, in terms of an average loop's."""


class GtsamParams(Params):
    """Noise of the odometry per step between keyframes, and of an average loop."""

    odometry_sigma_rad: float = Field(
        0.05, gt=0, description="Standard deviation of odometry between keyframes, in rotation."
    )
    odometry_sigma_m: float = Field(
        0.05, gt=0, description="Standard deviation of odometry between keyframes, in translation."
    )
    loop_sigma: float = Field(
        0.01,
        gt=0,
        description="Standard deviation of loops, the mean over the six axes, in rad and m.",
    )
    cauchy: float = Field(
        1.0, gt=0, description="Scale of the Cauchy robust kernel, in standard deviations."
    )
    tolerance: float = Field(
        0.01,
        ge=0,
        description="Disagreement of a loop with the map that is tolerated while frames arrive, "
        "in rad and m.",
    )
    n_updates: int = Field(3, gt=0, description="Number of iSAM2 updates after a loop.")
    max_iterations: int = Field(
        50, gt=0, description="Largest number of iterations of the final optimisation."
    )
    select_loops: bool = Field(
        True,
        description="Whether the final optimisation leaves out loops that are inconsistent with "
        "the others.",
    )
    selection: SelectionParams = SelectionParams()


class GtsamBackend:
    """Between factors from odometry and loops; loops under a robust kernel."""

    Params = GtsamParams

    def __init__(self, params: GtsamParams | None = None) -> None:
        self.params = p = params or GtsamParams()
        self._isam = gtsam.ISAM2(gtsam.ISAM2Params())
        self._nodes: dict[int, Node] = {}
        self._steps: dict[int, OdometryStep] = {}
        self._prior = gtsam.NonlinearFactorGraph()
        self._loops: dict[int, Noisy] = {}
        self._factors: dict[int, gtsam.NonlinearFactor] = {}
        """Factors of the loops, by the same numbers: to make one takes longer than to add it."""
        self._weights: list[float] = []
        self._inherited: list[Noisy] = []
        self._inherited_factors: list[gtsam.NonlinearFactor] = []
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._estimate = gtsam.Values()
        self._newest: Keyframe | None = None
        self._held = DisjointSet()
        self._has_new_loop = False
        self._is_optimized = False
        self._prior_noise = gtsam.noiseModel.Isotropic.Sigma(6, ROOT_SIGMA)
        self._odometry_noise = gtsam.noiseModel.Diagonal.Sigmas(
            step_sigmas(p.odometry_sigma_rad, p.odometry_sigma_m)
        )
        self._lost_noise = gtsam.noiseModel.Isotropic.Sigma(6, LOST_SIGMA)

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node at its pose by odometry, with a factor to the node before it.

        After ``optimize``, the graph goes on from its optimum, without the loops left out.
        """
        if self._is_optimized:
            self._start_afresh(gtsam.ISAM2Params())
        key, before = keyframe.id, self._newest
        factor: gtsam.NonlinearFactor
        if before is None:
            node = pose3(keyframe.T_odom_camera)
            factor = gtsam.PriorFactorPose3(key, node, self._prior_noise)
            self._prior.add(factor)
        else:
            motion = pose3(se3.inverse(before.T_odom_camera) @ keyframe.T_odom_camera)
            is_lost = keyframe.segment != before.segment
            noise = self._lost_noise if is_lost else self._step_noise(keyframe)
            self._steps[key] = OdometryStep(before.id, key, motion, noise, is_lost)
            factor = _factor(self._steps[key])
            node = self._estimate.atPose3(before.id).compose(motion)
        self._new_factors.add(factor)
        self._new_values.insert(key, node)
        self._estimate.insert(key, node)
        self._nodes[key] = Node(keyframe.stamp_s, keyframe.segment)
        self._newest = keyframe
        self._held.add(keyframe.segment)

    def set_odometry(
        self, T_odom_camera: Mapping[int, Pose], relative_sigmas: Array | None
    ) -> None:
        """Replace the odometry between nodes; it takes effect in the next ``optimize``."""
        for key, step in self._steps.items():
            is_changed = relative_sigmas is not None or step.is_precise
            if step.is_lost or not is_changed or not {step.before, key} <= T_odom_camera.keys():
                continue
            noise = self._odometry_noise
            if relative_sigmas is not None:
                sigma = self.params.loop_sigma * relative_sigmas * np.sqrt(abs(key - step.before))
                floored = np.maximum(sigma, STEP_FLOOR).tolist()
                noise = gtsam.noiseModel.Diagonal.Sigmas(step_sigmas(*floored))
            motion = se3.inverse(T_odom_camera[step.before]) @ T_odom_camera[key]
            self._steps[key] = step._replace(
                measured=pose3(motion), noise=noise, is_precise=relative_sigmas is not None
            )

    def move(self, keyframe_ids: NDArray[np.integer[Any]], T: Pose) -> None:
        """Carry nodes by ``T`` (4, 4) in the map, and start iSAM2 afresh from there.

        Steps without odometry are measured again in the moved map, so that they have no error.
        """
        motion = pose3(T)
        for key in keyframe_ids.tolist():
            self._estimate.update(key, motion.compose(self._estimate.atPose3(key)))
        for key, step in self._steps.items():
            if step.is_lost:
                before = self._estimate.atPose3(step.before)
                motion = before.between(self._estimate.atPose3(key))
                self._steps[key] = step._replace(measured=motion)
        self._start_afresh(gtsam.ISAM2Params())

    def contract(self, anchors: Mapping[int, int], max_edges: int) -> Array:
        """Contract nodes into their anchors, and start iSAM2 afresh with what stays.

        The graph is optimised first with the loops that wait for ``optimize``, since the poses of
        the nodes in their anchors are final.
        """
        self._estimate = optimized(self._graph(), self._estimate, self.params.n_updates)
        kept = [self._loops[k] for k in self._kept()]
        removed = attach(self._estimate, anchors, kept, self.params.loop_sigma)
        contraction = Contraction(
            removed,
            self._inherited,
            max_edges=max_edges,
            max_trace=MAX_GAIN * 6.0 / self.params.loop_sigma**2,
        )
        self._steps = contraction.steps(self._steps.values(), self._estimate)
        for edge, noise in kept:
            if contraction.touches(edge):
                contraction.compose(edge, self._weighted(edge, noise))
        self._inherited = contraction.inherited
        self._inherited_factors = [self._robust(*noisy) for noisy in self._inherited]
        self._loops = {
            k: loop for k, loop in self._loops.items() if not contraction.touches(loop[0])
        }
        self._factors = {k: self._factors[k] for k in self._loops}
        for key in anchors:
            self._estimate.erase(key)
            del self._nodes[key]
        self._start_afresh(gtsam.ISAM2Params())
        return np.array([node.T_anchor_node.matrix() for node in removed.values()])

    def add_loop(self, loop: Loop) -> None:
        """Add a verified edge; its information keeps its shape and is scaled to one trace.

        A loop that agrees with the map waits for ``optimize``: where the same place is seen over
        and over, iSAM2's tree would become dense and each update slower than the last. The first
        loop between two segments never waits, because otherwise only the step without odometry
        would place the second. Edges that are no loops never wait either, because the small errors
        that they correct would add up.
        """
        information = loop_information(loop.information, self.params.loop_sigma)
        noise = gtsam.noiseModel.Gaussian.Information(information)
        edge = Edge(loop.match_id, loop.query_id, pose3(loop.T_match_query))
        number = len(self._weights)
        self._loops[number], self._factors[number] = (edge, noise), self._robust(edge, noise)
        self._weights.append(1.0)
        joins = self._held.merge(*(self._nodes[key].segment for key in (edge.match, edge.query)))
        is_news = joins or self._is_news(edge)
        if is_news or loop.kind != EdgeKind.LOOP:
            self._new_factors.add(self._factors[number])
            self._has_new_loop |= is_news

    def update(self) -> None:
        """Bring the estimate up to date with the factors added since the last call."""
        try:
            self._isam.update(self._new_factors, self._new_values)
        except RuntimeError:
            # Cholesky may lose what constrains a variable, as it squares it; QR is slower.
            params = gtsam.ISAM2Params()
            params.setFactorization("QR")
            self._start_afresh(params)
            self._isam.update(self._new_factors, self._new_values)
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if self._has_new_loop:
            for _ in range(self.params.n_updates - 1):
                self._isam.update()
            self._has_new_loop = False
        self._estimate = self._isam.calculateEstimate()

    def optimize(self) -> NDArray[np.float64]:
        """Optimise the whole graph until it converges; return the weight of each loop, (L,)."""
        p = self.params
        if self._loops:
            weights = np.ones(len(self._loops))
            if p.select_loops:
                weights, self._estimate = weigh_loops(
                    self._nodes,
                    list(self._steps.values()),
                    self._placed(),
                    list(self._loops.values()),
                    self._inherited,
                    p.selection,
                )
            for k, weight in zip(self._loops, weights.tolist(), strict=True):
                self._weights[k] = weight
        self._estimate = optimized(self._graph(), self._estimate, p.max_iterations)
        self._is_optimized = True
        return np.array(self._weights)

    def poses(self) -> Array:
        """Return ``T_map_camera`` (n, 4, 4) of the nodes, in the order of their ids."""
        return poses_of(self._estimate)

    def write_g2o(self, path: Path) -> None:
        """Write nodes and edges as .g2o, without the loops left out.

        Robust kernels have no place in the format. Steps over which odometry was lost are left
        out too: they only keep the linear systems well-posed.
        """
        edges: list[Noisy] = [
            (Edge(*step[:3]), step.noise) for step in self._steps.values() if not step.is_lost
        ]
        edges += self._inherited + [self._loops[k] for k in self._kept()]
        write_g2o(
            path,
            zip(self._estimate.keys(), self.poses(), strict=True),
            [
                GraphEdge(edge.match, edge.query, edge.measured.matrix(), noise.information())
                for edge, noise in edges
            ],
        )

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present graph, with iSAM2 afresh from there."""
        before = Checkpoint()
        before.save(vars(self))
        prior, estimate = gtsam.NonlinearFactorGraph(self._prior), gtsam.Values(self._estimate)

        def restore() -> None:
            before.restore()
            self._prior = gtsam.NonlinearFactorGraph(prior)
            self._estimate = gtsam.Values(estimate)
            self._start_afresh(gtsam.ISAM2Params())

        return restore

    def _step_noise(self, keyframe: Keyframe) -> gtsam.noiseModel.Gaussian:
        """Return the noise of the step to a keyframe: its own covariance, or the usual one."""
        if keyframe.step_covariance is None:
            return self._odometry_noise
        floor = np.diag(step_sigmas(STEP_FLOOR, STEP_FLOOR) ** 2)
        return gtsam.noiseModel.Gaussian.Covariance(keyframe.step_covariance + floor)

    def _graph(self) -> gtsam.NonlinearFactorGraph:
        """Return the whole graph, without the loops left out."""
        graph = gtsam.NonlinearFactorGraph(self._prior)
        for step in self._steps.values():
            graph.add(_factor(step))
        for factor in self._inherited_factors:
            graph.add(factor)
        for k in self._kept():
            graph.add(self._factors[k])
        return graph

    def _start_afresh(self, params: gtsam.ISAM2Params) -> None:
        """Let the next update take the whole graph, from the estimate so far."""
        self._is_optimized = False
        self._isam = gtsam.ISAM2(params)
        self._new_factors = self._graph()
        self._new_values = gtsam.Values(self._estimate)

    def _placed(self) -> gtsam.Values:
        """Return odometry with each segment where the map has its first node."""
        placed = gtsam.Values()
        for key in self._nodes:
            step = self._steps.get(key)
            if step is None or step.is_lost:
                placed.insert(key, self._estimate.atPose3(key))
            else:
                placed.insert(key, placed.atPose3(step.before).compose(step.measured))
        return placed

    def _kept(self) -> list[int]:
        """Return the numbers of loops not left out when the graph was last optimised."""
        return [k for k in self._loops if self._weights[k] >= 0.5]

    def _is_news(self, edge: Edge) -> bool:
        """Return whether an edge contradicts the estimate by more than the tolerance."""
        return bool(np.abs(self._error(edge)).max() > self.params.tolerance)

    def _weighted(self, edge: Edge, noise: gtsam.noiseModel.Gaussian) -> gtsam.noiseModel.Gaussian:
        """Return the noise of an edge with the weight that the robust kernel gives it now."""
        error, information = self._error(edge), noise.information()
        weight = 1.0 / (1.0 + error @ information @ error / self.params.cauchy**2)
        return gtsam.noiseModel.Gaussian.Information(weight * information)

    def _error(self, edge: Edge) -> Array:
        """Return by how much (6,) the estimate differs from an edge."""
        match, query = self._estimate.atPose3(edge.match), self._estimate.atPose3(edge.query)
        return np.asarray(gtsam.Pose3.Logmap(edge.measured.between(match.between(query))))

    def _robust(self, edge: Edge, noise: gtsam.noiseModel.Gaussian) -> gtsam.NonlinearFactor:
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(self.params.cauchy)
        return gtsam.BetweenFactorPose3(*edge, gtsam.noiseModel.Robust.Create(kernel, noise))


def _factor(step: OdometryStep) -> gtsam.NonlinearFactor:
    return gtsam.BetweenFactorPose3(step.before, step.node, step.measured, step.noise)
