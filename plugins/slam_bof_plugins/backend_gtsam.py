"""The pose graph in GTSAM: iSAM2 while frames come, Levenberg-Marquardt at the end.

GTSAM's traps are kept here: Pose3's tangent is rotation first; a non-orthonormal Rot3 kills the
interpreter; one iSAM2 update after a loop has not converged.
"""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
from pydantic import Field

from slam_bof import se3
from slam_bof.types import Array, Keyframe, Loop, Params, Pose

__all__ = ["GtsamBackend", "GtsamParams"]


class GtsamParams(Params):
    """Noise of the odometry per step between keyframes, and of an average loop."""

    odometry_sigma_rad: float = Field(0.05, gt=0)
    odometry_sigma_m: float = Field(0.05, gt=0)
    loop_sigma: float = Field(0.01, gt=0, description="mean over the six axes, rad and m")
    cauchy: float = Field(1.0, gt=0, description="of the robust kernel, in sigmas")
    n_updates: int = Field(3, gt=0, description="iSAM2 updates after a loop")
    max_iterations: int = Field(50, gt=0)


class GtsamBackend:
    """Between factors from odometry and loops; loops under a robust kernel."""

    Params = GtsamParams

    def __init__(self, params: GtsamParams | None = None) -> None:
        self.params = p = params or GtsamParams()
        self._isam = gtsam.ISAM2(gtsam.ISAM2Params())
        self._graph = gtsam.NonlinearFactorGraph()
        self._new_factors = gtsam.NonlinearFactorGraph()
        self._new_values = gtsam.Values()
        self._estimate = gtsam.Values()
        self._T_odom_camera: list[Pose] = []
        self._edges: list[tuple[int, int, gtsam.Pose3, gtsam.noiseModel.Gaussian]] = []
        self._has_new_loop = False
        self._prior_noise = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
        self._odometry_noise = gtsam.noiseModel.Diagonal.Sigmas(
            np.repeat([p.odometry_sigma_rad, p.odometry_sigma_m], 3)
        )

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Add a node where the odometry puts it, tied to the node before it."""
        key = len(self._T_odom_camera)
        if key == 0:
            node = _pose3(keyframe.T_odom_camera)
            self._add_factor(gtsam.PriorFactorPose3(key, node, self._prior_noise))
        else:
            motion = _pose3(se3.inverse(self._T_odom_camera[-1]) @ keyframe.T_odom_camera)
            self._add_factor(gtsam.BetweenFactorPose3(key - 1, key, motion, self._odometry_noise))
            self._edges.append((key - 1, key, motion, self._odometry_noise))
            node = self._estimate.atPose3(key - 1).compose(motion)
        self._new_values.insert(key, node)
        self._estimate.insert(key, node)
        self._T_odom_camera.append(keyframe.T_odom_camera)

    def add_loop(self, loop: Loop) -> None:
        """Add a verified edge; its information keeps its shape and is scaled to one trace."""
        p = self.params
        shape = loop.information / np.trace(loop.information) * 6.0
        noise = gtsam.noiseModel.Gaussian.Information(shape / p.loop_sigma**2)
        kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(p.cauchy)
        measured = _pose3(loop.T_match_query)
        self._add_factor(
            gtsam.BetweenFactorPose3(
                loop.match_id,
                loop.query_id,
                measured,
                gtsam.noiseModel.Robust.Create(kernel, noise),
            )
        )
        self._edges.append((loop.match_id, loop.query_id, measured, noise))
        self._has_new_loop = True

    def update(self) -> None:
        """Bring the estimate up to date with the factors added since the last call."""
        self._isam.update(self._new_factors, self._new_values)
        self._new_factors, self._new_values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        if self._has_new_loop:
            for _ in range(self.params.n_updates - 1):
                self._isam.update()
            self._has_new_loop = False
        self._estimate = self._isam.calculateEstimate()

    def optimize(self) -> None:
        """Optimise the whole graph until it converges."""
        params = gtsam.LevenbergMarquardtParams()
        params.setMaxIterations(self.params.max_iterations)
        optimizer = gtsam.LevenbergMarquardtOptimizer(self._graph, self._estimate, params)
        self._estimate = optimizer.optimize()

    def poses(self) -> Array:
        """Return ``T_map_camera`` of every keyframe, (K, 4, 4)."""
        poses = [self._estimate.atPose3(key).matrix() for key in range(len(self._T_odom_camera))]
        return np.array(poses).reshape(-1, 4, 4)

    def write_g2o(self, path: Path) -> None:
        """Write nodes and edges as .g2o; GTSAM puts the translation first, as g2o has it."""
        graph = gtsam.NonlinearFactorGraph()
        for match, query, measured, noise in self._edges:
            # Robust models have no place in the format: the plain one is written.
            graph.add(gtsam.BetweenFactorPose3(match, query, measured, noise))
        gtsam.writeG2o(graph, self._estimate, str(path))

    def _add_factor(self, factor: gtsam.NonlinearFactor) -> None:
        self._graph.add(factor)
        self._new_factors.add(factor)


def _pose3(T: Pose) -> gtsam.Pose3:
    return gtsam.Pose3(gtsam.Rot3(se3.nearest_rotation(T[:3, :3])), T[:3, 3])
