"""The pose graph in GTSAM: iSAM2 while frames come, Levenberg-Marquardt at the end.

Before the end all loops are weighed together, and those that contradict the rest are left out.
GTSAM's traps are kept here: Pose3's tangent is rotation first; a non-orthonormal Rot3 kills the
interpreter; one iSAM2 update after a loop has not converged.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import gtsam
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.cluster.hierarchy import DisjointSet

from slam_bof.core import Checkpoint
from slam_bof.geometry import GraphEdge, loop_information, se3, step_sigmas, write_g2o
from slam_bof.types import Array, Keyframe, Loop, Params, Pose
from slam_bof_plugins.gtsam_selection import (
    LOST_SIGMA,
    ROOT_SIGMA,
    Edge,
    SelectionParams,
    optimized,
    pose3,
    poses_of,
    weigh_loops,
)

__all__ = ["GtsamBackend", "GtsamParams"]


STEP_FLOOR = 1e-4
"""Smallest standard deviation of a step, in rad and m: smaller ones make the equations singular."""


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
        self._odometry = gtsam.NonlinearFactorGraph()
        self._loops: list[tuple[Edge, gtsam.noiseModel.Gaussian]] = []
        self._weights: NDArray[np.float64] = np.empty(0)
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._estimate = gtsam.Values()
        self._T_odom_camera: list[Pose] = []
        self._stamps_s: list[float] = []
        self._segments: list[int] = []
        self._held = DisjointSet()
        self._has_new_loop = False
        self._is_optimized = False
        self._prior_noise = gtsam.noiseModel.Isotropic.Sigma(6, ROOT_SIGMA)
        self._odometry_noise = gtsam.noiseModel.Diagonal.Sigmas(
            step_sigmas(p.odometry_sigma_rad, p.odometry_sigma_m)
        )
        self._lost_noise = gtsam.noiseModel.Isotropic.Sigma(6, LOST_SIGMA)

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node where the odometry puts it, tied to the node before it.

        After ``optimize``, the graph goes on from its optimum, without the loops left out.
        """
        if self._is_optimized:
            self._start_afresh(gtsam.ISAM2Params())
        key = len(self._T_odom_camera)
        factor: gtsam.NonlinearFactor
        if key == 0:
            node = pose3(keyframe.T_odom_camera)
            factor = gtsam.PriorFactorPose3(key, node, self._prior_noise)
        else:
            motion = pose3(se3.inverse(self._T_odom_camera[-1]) @ keyframe.T_odom_camera)
            is_lost = keyframe.segment != self._segments[-1]
            noise = self._lost_noise if is_lost else self._step_noise(keyframe)
            factor = gtsam.BetweenFactorPose3(key - 1, key, motion, noise)
            node = self._estimate.atPose3(key - 1).compose(motion)
        self._odometry.add(factor)
        self._new_factors.add(factor)
        self._new_values.insert(key, node)
        self._estimate.insert(key, node)
        self._T_odom_camera.append(keyframe.T_odom_camera)
        self._stamps_s.append(keyframe.stamp_s)
        self._segments.append(keyframe.segment)
        self._held.add(keyframe.segment)

    def move(self, keyframe_ids: NDArray[np.integer[Any]], T: Pose) -> None:
        """Carry nodes by ``T`` (4, 4) in the map, and start iSAM2 afresh from there.

        What steps without odometry were taken to be becomes what they are now, so that they pull
        at nothing.
        """
        motion = pose3(T)
        for key in keyframe_ids.tolist():
            self._estimate.update(key, motion.compose(self._estimate.atPose3(key)))
        for key in np.flatnonzero(np.diff(self._segments)) + 1:
            step = self._estimate.atPose3(key - 1).between(self._estimate.atPose3(key))
            factor = gtsam.BetweenFactorPose3(key - 1, key, step, self._lost_noise)
            self._odometry.replace(key, factor)
        self._start_afresh(gtsam.ISAM2Params())

    def add_loop(self, loop: Loop) -> None:
        """Add a verified edge; its information keeps its shape and is scaled to one trace.

        One that says what the map has already waits for the end: where the same place is seen
        over and over, iSAM2's tree would become dense and each update slower than the last. The
        first between two segments never waits: without, the lost step alone would place them.
        """
        information = loop_information(loop.information, self.params.loop_sigma)
        noise = gtsam.noiseModel.Gaussian.Information(information)
        edge = Edge(loop.match_id, loop.query_id, pose3(loop.T_match_query))
        self._loops.append((edge, noise))
        joins = self._held.merge(self._segments[edge.match], self._segments[edge.query])
        if joins or self._is_news(edge):
            self._new_factors.add(self._robust(edge, noise))
            self._has_new_loop = True

    def update(self) -> None:
        """Bring the estimate up to date with the factors added since the last call."""
        try:
            self._isam.update(self._new_factors, self._new_values)
        except RuntimeError:
            # Cholesky's squares may lose what ties a variable; QR is slower and does not.
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
        self._weights = np.ones(len(self._loops))
        if p.select_loops and self._loops:
            self._weights, self._estimate = weigh_loops(
                self._placed(),
                np.array(self._segments),
                np.array(self._stamps_s),
                [edge for edge, _ in self._loops],
                [noise.information() for _, noise in self._loops],
                p.selection,
            )
        graph = gtsam.NonlinearFactorGraph(self._odometry)
        for loop in self._kept():
            graph.add(self._robust(*loop))
        self._estimate = optimized(graph, self._estimate, p.max_iterations)
        self._is_optimized = True
        return self._weights

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""
        return poses_of(self._estimate)

    def write_g2o(self, path: Path) -> None:
        """Write nodes and edges as .g2o, without the loops left out.

        Robust kernels have no place in the format. Steps over which odometry was lost are left
        out too: they only keep the linear systems well-posed.
        """
        T = self._T_odom_camera
        edges = [
            GraphEdge(k - 1, k, se3.inverse(T[k - 1]) @ T[k], self._step_information(k))
            for k in range(1, len(T))
            if self._segments[k - 1] == self._segments[k]
        ]
        edges += [
            GraphEdge(edge.match, edge.query, edge.measured.matrix(), noise.information())
            for edge, noise in self._kept()
        ]
        write_g2o(path, enumerate(self.poses()), edges)

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present graph, with iSAM2 afresh from there."""
        before = Checkpoint()
        before.save(vars(self))
        odometry, estimate = (
            gtsam.NonlinearFactorGraph(self._odometry),
            gtsam.Values(self._estimate),
        )

        def restore() -> None:
            before.restore()
            self._odometry = gtsam.NonlinearFactorGraph(odometry)
            self._estimate = gtsam.Values(estimate)
            self._start_afresh(gtsam.ISAM2Params())

        return restore

    def _step_noise(self, keyframe: Keyframe) -> gtsam.noiseModel.Gaussian:
        """Return the noise of the step to a keyframe: its own covariance, or the usual one."""
        if keyframe.step_covariance is None:
            return self._odometry_noise
        floor = np.diag(step_sigmas(STEP_FLOOR, STEP_FLOOR) ** 2)
        return gtsam.noiseModel.Gaussian.Covariance(keyframe.step_covariance + floor)

    def _step_information(self, key: int) -> Array:
        """Return the information (6, 6) of the step to a keyframe."""
        factor: Any = self._odometry.at(key)
        return np.asarray(factor.noiseModel().information())

    def _start_afresh(self, params: gtsam.ISAM2Params) -> None:
        """Let the next update take the whole graph, from the estimate so far."""
        self._is_optimized = False
        self._isam = gtsam.ISAM2(params)
        self._new_factors = gtsam.NonlinearFactorGraph(self._odometry)
        for loop in self._kept():
            self._new_factors.add(self._robust(*loop))
        self._new_values = gtsam.Values(self._estimate)

    def _placed(self) -> Array:
        """Return odometry (K, 4, 4) with each segment where the map has its first node."""
        T_odom_camera, T_map_camera = np.array(self._T_odom_camera), self.poses()
        _, first, segment = np.unique(self._segments, return_index=True, return_inverse=True)
        T_map_odom = T_map_camera[first] @ se3.inverse(T_odom_camera[first])
        return np.asarray(T_map_odom[segment] @ T_odom_camera)

    def _kept(self) -> list[tuple[Edge, gtsam.noiseModel.Gaussian]]:
        """Return the loops that were not left out when the graph was last optimised."""
        left_out = np.flatnonzero(self._weights < 0.5)
        return [loop for k, loop in enumerate(self._loops) if k not in left_out]

    def _is_news(self, edge: Edge) -> bool:
        """Tell whether an edge contradicts the estimate by more than the tolerance."""
        match, query = self._estimate.atPose3(edge.match), self._estimate.atPose3(edge.query)
        error = gtsam.Pose3.Logmap(edge.measured.between(match.between(query)))
        return bool(np.abs(error).max() > self.params.tolerance)

    def _robust(self, edge: Edge, noise: gtsam.noiseModel.Gaussian) -> gtsam.NonlinearFactor:
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(self.params.cauchy)
        return gtsam.BetweenFactorPose3(*edge, gtsam.noiseModel.Robust.Create(kernel, noise))
