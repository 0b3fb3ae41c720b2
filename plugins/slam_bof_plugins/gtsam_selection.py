"""Which loops of a pose graph agree with each other and with what odometry can have drifted.

Graduated non-convexity (Yang et al., RA-L 2020) over all loops at once, with truncated least
squares: it finds the few that contradict the many, which a robust kernel cannot undo once they
have bent the graph. First the motion from keyframe to keyframe is settled by odometry and the
edges between neighbours in time, under robust kernels, so that a slip of odometry that its
neighbours correct is not held against the loops.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Array, Params, Pose

__all__ = [
    "LOST_SIGMA",
    "Edge",
    "Node",
    "Noisy",
    "OdometryStep",
    "SelectionParams",
    "optimized",
    "pose3",
    "poses_of",
    "weigh_loops",
]

ROOT_SIGMA = 1e-3
"""Standard deviation of the prior of the first node, in rad and m; nothing pulls at it."""
OPEN_SIGMA = 10.0
"""Standard deviation of an edge along the directions that it leaves open, in rad and m."""
MAX_OPEN_SHARE = 1e-4
"""An edge leaves a direction open if it holds less than this share of the edge's information."""
LOST_SIGMA = 1.0
"""Standard deviation of a step over which odometry was lost, in rad and m. A loop outweighs it; if
it were far larger, the linear systems would be ill-posed."""


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


class OdometryStep(NamedTuple):
    """Odometry to a node from the one before: all but the first have one, and form a tree.

    ``is_lost`` says that odometry was lost on the way, and that the step is worth next to nothing.
    ``is_precise`` says that it is as precise as a loop: then it judges loops by its own noise.
    """

    before: int
    node: int
    measured: gtsam.Pose3
    noise: gtsam.noiseModel.Gaussian
    is_lost: bool
    is_precise: bool = False


class Node(NamedTuple):
    """When a keyframe was taken, and in which uninterrupted track."""

    stamp_s: float
    segment: int


Noisy = tuple[Edge, gtsam.noiseModel.Gaussian]
"""An edge and its noise."""


def weigh_loops(
    nodes: Mapping[int, Node],
    steps: Sequence[OdometryStep],
    start: gtsam.Values,
    loops: Sequence[Noisy],
    inherited: Sequence[Noisy],
    params: SelectionParams,
) -> tuple[NDArray[np.float64], gtsam.Values]:
    """Weigh each loop in [0, 1]: near 0 where it contradicts the others.

    Parameters
    ----------
    nodes, steps
        The keyframes and the odometry between them.
    start
        The poses of the nodes by odometry, segments placed about where they belong.
    loops
        Edges over less than ``local_s`` in one segment are not judged and weigh 1. What an edge
        leaves open speaks neither for nor against it.
    inherited
        Edges that are known to be right.

    Returns
    -------
    weights : (L,)
    values
        The poses of the nodes by the loops that agree, at which optimisation starts.
    """
    far = np.array([_is_far(nodes, edge, params.local_s) for edge, _ in loops], np.bool_)
    weights = np.ones(len(loops))
    near = [loop for loop, is_far in zip(loops, far, strict=True) if not is_far]
    values = _settle(start, steps, near, params)
    if not any(far):
        return weights, values
    graph = _chain(values, steps, gtsam.noiseModel.Isotropic.Sigma(6, params.step_sigma))
    for edge, noise in inherited:
        graph.add(gtsam.BetweenFactorPose3(*edge, _held_noise(noise, params.loop_sigma)))
    n_known = graph.size()
    for k in np.flatnonzero(far).tolist():
        edge, noise = loops[k]
        graph.add(gtsam.BetweenFactorPose3(*edge, _held_noise(noise, params.loop_sigma)))
    gnc = gtsam.GncLMParams()
    gnc.setKnownInliers(list(range(n_known)))
    optimizer = gtsam.GncLMOptimizer(graph, values, gnc)
    optimizer.setInlierCostThresholdsAtProbability(params.inlier_probability)
    values = optimizer.optimize()
    weights[far] = np.asarray(optimizer.getWeights())[n_known:]
    return weights, values


def _is_far(nodes: Mapping[int, Node], edge: Edge, local_s: float) -> bool:
    query, match = nodes[edge.query], nodes[edge.match]
    return query.segment != match.segment or abs(query.stamp_s - match.stamp_s) >= local_s


def _held_noise(noise: gtsam.noiseModel.Gaussian, sigma: float) -> gtsam.noiseModel.Base:
    """Return noise of one sigma along the directions that an edge holds."""
    values, axes = np.linalg.eigh(noise.information())
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
    start: gtsam.Values,
    steps: Sequence[OdometryStep],
    near: Sequence[Noisy],
    params: SelectionParams,
) -> gtsam.Values:
    """Return the nodes by odometry and the edges between neighbours, all robust."""
    kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(1.0)
    steady = gtsam.noiseModel.Isotropic.Sigma(6, params.local_sigma)
    graph = _chain(start, steps, gtsam.noiseModel.Robust.Create(kernel, steady))
    for edge, noise in near:
        held = _held_noise(noise, params.local_sigma)
        graph.add(gtsam.BetweenFactorPose3(*edge, gtsam.noiseModel.Robust.Create(kernel, held)))
    return optimized(graph, start)


def _chain(
    values: gtsam.Values, steps: Sequence[OdometryStep], noise: gtsam.noiseModel.Base
) -> gtsam.NonlinearFactorGraph:
    """Return a graph that holds the first node fast and each other one to the one before it.

    From segment to segment it hardly holds; precise steps are those of odometry.
    """
    graph = gtsam.NonlinearFactorGraph()
    fast = gtsam.noiseModel.Isotropic.Sigma(6, ROOT_SIGMA)
    root = min(values.keys())
    graph.add(gtsam.PriorFactorPose3(root, values.atPose3(root), fast))
    loose = gtsam.noiseModel.Isotropic.Sigma(6, LOST_SIGMA)
    for step in steps:
        motion = values.atPose3(step.before).between(values.atPose3(step.node))
        held = loose if step.is_lost else noise
        if step.is_precise:
            motion, held = step.measured, step.noise
        graph.add(gtsam.BetweenFactorPose3(step.before, step.node, motion, held))
    return graph
