"""Which loops of a pose graph agree with each other and with what odometry can have drifted.

Graduated non-convexity (Yang et al., RA-L 2020) over all loops at once, with truncated least
squares: it finds the few that contradict the many, which a robust kernel cannot undo once they
have bent the graph. First the motion from keyframe to keyframe is settled by odometry and the
edges between neighbours in time, under robust kernels, so that a slip of odometry that its
neighbours mend is not held against the loops.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Array, Params, Pose

__all__ = ["LOST_SIGMA", "Edge", "SelectionParams", "optimized", "pose3", "poses_of", "weigh_loops"]

ROOT_SIGMA = 1e-3
"""Of the first node, in rad and in m; nothing pulls at it."""
OPEN_SIGMA = 10.0
"""Of an edge along the directions that it leaves open, in rad and m."""
MAX_OPEN_SHARE = 1e-4
"""An edge leaves a direction open if it holds less than this share of the edge's information."""
LOST_SIGMA = 1.0
"""Of a step over which odometry was lost. Far less certain, and the linear systems become
ill-posed; this too is nothing beside a loop."""


class SelectionParams(Params):
    """Parameters of the selection of loops; standard deviations apply in rad and in m."""

    step_sigma: float = Field(
        0.01,
        gt=0,
        description="Standard deviation of a corrected step between keyframes, in rad and m.",
    )
    loop_sigma: float = Field(
        0.05, gt=0, description="Standard deviation of a correct loop, in rad and m."
    )
    inlier_probability: float = Field(
        0.99, gt=0, lt=1, description="Probability with which a correct loop is kept."
    )
    local_s: float = Field(
        3.0, gt=0, description="Edges over less time than this correct the steps between keyframes."
    )
    local_sigma: float = Field(
        0.02,
        gt=0,
        description="Standard deviation of these edges and of odometry while steps are corrected,"
        " in rad and m.",
    )


class Edge(NamedTuple):
    """A loop between two nodes: ``measured`` is ``T_match_query``."""

    match: int
    query: int
    measured: gtsam.Pose3


def weigh_loops(
    T_odom_camera: Array,
    segments: NDArray[np.integer[Any]],
    stamps_s: Array,
    edges: Sequence[Edge],
    informations: Sequence[Array],
    params: SelectionParams,
) -> tuple[NDArray[np.float64], gtsam.Values]:
    """Weigh each edge in [0, 1]: near 0 where it contradicts the others.

    Parameters
    ----------
    T_odom_camera
        (K, 4, 4) odometry of the nodes, segments placed about where they belong.
    segments
        (K,) which uninterrupted track the nodes belong to, growing; between two of them odometry
        says nothing.
    stamps_s
        (K,) their times; edges over less than ``local_s`` in one segment are not judged and
        weigh 1.
    informations
        (E,) their information (6, 6). What an edge leaves open speaks neither for nor against it.

    Returns
    -------
    weights : (E,)
    values
        The nodes as those that agree have them: where to start optimising from.
    """
    query, match = np.array([(e.query, e.match) for e in edges], dtype=np.intp).reshape(-1, 2).T
    far = np.abs(stamps_s[query] - stamps_s[match]) >= params.local_s
    far |= segments[query] != segments[match]
    weights = np.ones(len(edges))
    near = np.flatnonzero(~far).tolist()
    settled = _settle(
        T_odom_camera, segments, [edges[k] for k in near], [informations[k] for k in near], params
    )
    if not any(far):
        return weights, _values(settled)
    steady = gtsam.noiseModel.Isotropic.Sigma(6, params.step_sigma)
    graph = _chain(settled, segments, steady)
    n_visible = graph.size()
    for k in np.flatnonzero(far).tolist():
        noise = _held_noise(informations[k], params.loop_sigma)
        graph.add(gtsam.BetweenFactorPose3(*edges[k], noise))
    gnc = gtsam.GncLMParams()
    gnc.setKnownInliers(list(range(n_visible)))
    optimizer = gtsam.GncLMOptimizer(graph, _values(settled), gnc)
    optimizer.setInlierCostThresholdsAtProbability(params.inlier_probability)
    values = optimizer.optimize()
    weights[far] = np.asarray(optimizer.getWeights())[n_visible:]
    return weights, values


def _held_noise(information: Array, sigma: float) -> gtsam.noiseModel.Base:
    """Return noise of one sigma along the directions that an edge holds."""
    values, axes = np.linalg.eigh(information)
    open_axes = axes[:, values < MAX_OPEN_SHARE * values.sum()]
    if open_axes.shape[1] == 0:
        return gtsam.noiseModel.Isotropic.Sigma(6, sigma)
    covariance = sigma**2 * np.eye(6) + OPEN_SIGMA**2 * open_axes @ open_axes.T
    return gtsam.noiseModel.Gaussian.Covariance(covariance)


def pose3(T: Pose) -> gtsam.Pose3:
    """Return a (4, 4) transform as GTSAM's; one that is not quite rigid would kill the process."""
    return gtsam.Pose3(gtsam.Rot3(se3.nearest_rotation(T[:3, :3])), T[:3, 3])


def poses_of(values: gtsam.Values) -> Array:
    """Return all nodes, by their keys, as (n, 4, 4)."""
    rows = gtsam.utilities.extractPose3(values)  # rotation row by row, then translation
    T = np.tile(np.eye(4), (len(rows), 1, 1))
    T[:, :3, :3] = rows[:, :9].reshape(-1, 3, 3)
    T[:, :3, 3] = rows[:, 9:]
    return T


def optimized(
    graph: gtsam.NonlinearFactorGraph, initial: gtsam.Values, max_iterations: int = 50
) -> gtsam.Values:
    """Return the values where Levenberg-Marquardt converges."""
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(max_iterations)
    return gtsam.LevenbergMarquardtOptimizer(graph, initial, params).optimize()


def _settle(
    T_odom_camera: Array,
    segments: NDArray[np.integer[Any]],
    edges: Sequence[Edge],
    informations: Sequence[Array],
    params: SelectionParams,
) -> Array:
    """Return the nodes (K, 4, 4) by odometry and the edges between neighbours, all robust."""
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)
    steady = gtsam.noiseModel.Isotropic.Sigma(6, params.local_sigma)
    graph = _chain(T_odom_camera, segments, gtsam.noiseModel.Robust.Create(kernel, steady))
    for edge, information in zip(edges, informations, strict=True):
        noise = _held_noise(information, params.local_sigma)
        graph.add(gtsam.BetweenFactorPose3(*edge, gtsam.noiseModel.Robust.Create(kernel, noise)))
    return poses_of(optimized(graph, _values(T_odom_camera)))


def _chain(
    poses: Array, segments: NDArray[np.integer[Any]], noise: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactorGraph:
    """Return a graph that holds the first node fast and each other one to the one before it.

    From segment to segment it hardly holds.
    """
    graph = gtsam.NonlinearFactorGraph()
    fast = gtsam.noiseModel.Isotropic.Sigma(6, ROOT_SIGMA)
    graph.add(gtsam.PriorFactorPose3(0, pose3(poses[0]), fast))
    loose = gtsam.noiseModel.Isotropic.Sigma(6, LOST_SIGMA)
    steps = se3.inverse(poses[:-1]) @ poses[1:]
    for key, step in enumerate(steps):
        is_lost = segments[key] != segments[key + 1]
        graph.add(gtsam.BetweenFactorPose3(key, key + 1, pose3(step), loose if is_lost else noise))
    return graph


def _values(poses: Array) -> gtsam.Values:
    values = gtsam.Values()
    for key, pose in enumerate(poses):
        values.insert(key, pose3(pose))
    return values
