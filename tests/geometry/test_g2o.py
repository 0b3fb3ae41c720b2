"""Pose graphs as .g2o, read back by an independent reader that takes the format at its word."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from slam_bof.geometry import GraphEdge, loop_information, se3, step_sigmas, write_g2o

N = 6


def read(path):
    """Return nodes {id: (7,)} and edges (a, b, (7,), (6, 6)), as in the file."""
    nodes, edges = {}, []
    for line in path.read_text().splitlines():
        tag, *numbers = line.split()
        if tag == "VERTEX_SE3:QUAT":
            nodes[int(numbers[0])] = np.array(numbers[1:], float)
        else:
            information = np.zeros((6, 6))
            information[np.triu_indices(6)] = np.array(numbers[9:], float)
            information += np.triu(information, 1).T
            edges.append(
                (int(numbers[0]), int(numbers[1]), np.array(numbers[2:9], float), information)
            )
    return nodes, edges


def relative(a, b):
    """Return translation and quaternion of b as seen from a."""
    R = Rotation.from_quat(a[3:]).inv()
    q = (R * Rotation.from_quat(b[3:])).as_quat(canonical=True)
    return np.concatenate([R.apply(b[:3] - a[:3]), q])


def g2o_error(a, b, measured):
    """Return g2o's error of an edge: translation and vector part of the quaternion."""
    return relative(measured, relative(a, b))[:6]


def optimum(nodes, edges):
    """Minimise the sum of squared g2o errors, the first node held."""
    ids = sorted(nodes)
    start = np.array([nodes[i] for i in ids])

    def moved(x):
        change = np.concatenate([np.zeros(6), x]).reshape(-1, 6)
        R = Rotation.from_quat(start[:, 3:]) * Rotation.from_rotvec(change[:, 3:])
        return np.hstack([start[:, :3] + change[:, :3], R.as_quat()])

    def residuals(x):
        poses = dict(zip(ids, moved(x), strict=True))
        return np.concatenate(
            [
                np.linalg.cholesky(information).T @ g2o_error(poses[a], poses[b], measured)
                for a, b, measured, information in edges
            ]
        )

    found = least_squares(residuals, np.zeros(6 * (len(ids) - 1)), x_scale="jac", xtol=1e-14)
    return moved(found.x)


@pytest.fixture
def graph():
    """A chain that drifts, and a loop whose directions are held unequally."""
    rng = np.random.default_rng(3)
    truth = [np.eye(4)]
    for _ in range(N - 1):
        truth.append(truth[-1] @ se3.exp(np.array([0.1, 0.4, -0.2, 0.3, 0.0, 0.5])))
    steps = np.diag(step_sigmas(0.05, 0.02) ** -2.0)
    edges = [
        GraphEdge(
            k,
            k + 1,
            se3.inverse(truth[k]) @ truth[k + 1] @ se3.exp(0.01 * rng.standard_normal(6)),
            steps,
        )
        for k in range(N - 1)
    ]
    shape = rng.standard_normal((6, 6))
    information = loop_information(shape @ shape.T + 0.1 * np.eye(6), 0.01)
    edges.append(GraphEdge(0, N - 1, se3.inverse(truth[0]) @ truth[-1], information))
    return truth, edges


def test_an_edge_costs_in_the_file_what_it_costs_in_the_graph(graph, tmp_path):
    truth, edges = graph
    write_g2o(tmp_path / "graph.g2o", enumerate(truth), edges)
    nodes, written = read(tmp_path / "graph.g2o")
    for ours, (a, b, measured, information) in zip(edges, written, strict=True):
        assert (a, b) == (ours.a, ours.b)
        error = g2o_error(nodes[a], nodes[b], measured)
        tangent = se3.log(se3.inverse(ours.T_a_b) @ se3.inverse(truth[a]) @ truth[b])
        cost = tangent @ ours.information @ tangent
        assert error @ information @ error == pytest.approx(cost, rel=0.01, abs=1e-12)


def test_the_optimum_of_the_file_is_that_of_the_graph(graph, tmp_path):
    gtsam = pytest.importorskip("gtsam")
    truth, edges = graph
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    factors.add(gtsam.PriorFactorPose3(0, gtsam.Pose3(truth[0]), prior))
    for k, T in enumerate(truth):
        values.insert(k, gtsam.Pose3(T))
    for edge in edges:
        noise = gtsam.noiseModel.Gaussian.Information(edge.information)
        factors.add(gtsam.BetweenFactorPose3(edge.a, edge.b, gtsam.Pose3(edge.T_a_b), noise))
    best = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    poses = [best.atPose3(k).matrix() for k in range(N)]
    write_g2o(tmp_path / "graph.g2o", enumerate(poses), edges)
    found = optimum(*read(tmp_path / "graph.g2o"))
    np.testing.assert_allclose(found[:, :3], [T[:3, 3] for T in poses], atol=3e-4)


def test_the_mean_information_of_a_loop_is_that_of_sigma():
    shape = np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0])
    scaled = loop_information(shape, 0.02)
    assert np.trace(scaled) / 6 == pytest.approx(0.02**-2)
    np.testing.assert_allclose(scaled / scaled[0, 0], shape)
