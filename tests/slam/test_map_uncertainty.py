"""Covariances of keyframes, where poses and the noise of edges are known."""

import numpy as np
import pytest

from slam_bof.core import registry
from slam_bof.geometry import se3
from slam_bof.slam.graph_paths import Links
from slam_bof.slam.map_uncertainty import OPEN_VARIANCE, VIEW_FACTOR, PoseUncertainty
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.types import Bag, CandidateSource, EdgeKind, Keyframe, Loop

N, REACH = 40, 4
SIGMAS = np.repeat([0.003, 0.01], 3)
"""Of an edge, in rad and m."""
INFORMATION = 50.0 * np.diag(1.0 / SIGMAS**2)
"""Its proportions are right, its scale is not."""
EMPTY = Bag(np.empty(0, np.int32), np.empty(0, np.float32))
STEP = se3.exp(np.array([0.0, 2 * np.pi / N, 0.0, 0.0, 0.0, 0.2]))


def graph_of(rng, *, view=0.0, scale=1.0):
    """Return true poses on a circle, and the graph of edges to some keyframes before each."""
    truth = np.array([np.linalg.matrix_power(STEP, k) for k in range(N)])
    seen = np.array([T @ se3.exp(view * SIGMAS * rng.standard_normal(6)) for T in truth])
    seen[0] = truth[0]
    odometry = [np.eye(4)]
    for _ in range(N):
        odometry.append(odometry[-1] @ STEP @ se3.exp(5.0 * SIGMAS * rng.standard_normal(6)))
    graph = MapGraph(registry.build("backends", "gtsam"))
    for k in range(N):
        T = odometry[k]
        graph.add_keyframe(Keyframe(k, k, float(k), T, EMPTY, None, T_odom_raw=T))
        graph.add_loops(
            Loop(
                k,
                i,
                se3.inverse(seen[i]) @ seen[k] @ se3.exp(scale * SIGMAS * rng.standard_normal(6)),
                INFORMATION,
                EdgeKind.COVISIBILITY,
                CandidateSource.PROXIMITY,
            )
            for i in range(max(0, k - REACH), k)
        )
    return truth, graph


@pytest.mark.parametrize(
    ("view", "scale", "least"), [(0.0, 1.0, 0.03), (0.0, 4.0, 0.03), (1.0, 1.0, 0.1)]
)
def test_poses_err_at_most_as_their_covariances_say(view, scale, least):
    squares = []
    for seed in range(8):
        truth, graph = graph_of(np.random.default_rng(seed), view=view, scale=scale)
        graph.optimize()
        errors = [
            se3.log(se3.inverse(T) @ true)
            for T, true in zip(graph.poses()[1:], truth[1:], strict=True)
        ]
        covariances = graph.covariances()[1:]
        squares += [e @ np.linalg.solve(C, e) / 6 for e, C in zip(errors, covariances, strict=True)]
    # Along parallel paths errors average out, unless they are those of views.
    assert least < np.mean(squares) < 1.0


def test_edges_that_agree_exactly_are_not_certain_beyond_rounding():
    _, graph = graph_of(np.random.default_rng(0), scale=0.0)
    graph.cull({20: 0}, max_edges=20)
    assert (np.linalg.eigvalsh(graph.covariances()[1:]) > 0.0).all()


@pytest.mark.parametrize("scale", [0.5, 1.0, 3.0])
def test_the_scale_of_edges_is_learnt_from_their_closures(scale):
    _, graph = graph_of(np.random.default_rng(0), scale=scale)
    expected = VIEW_FACTOR * (scale * SIGMAS[[0, 3]]) ** 2
    assert graph.uncertainty.edge_variances() == pytest.approx(expected, rel=0.3)


def test_the_covariance_grows_along_the_path_and_falls_with_a_loop():
    truth, graph = graph_of(np.random.default_rng(1))
    variances = np.trace(graph.covariances()[:, 3:, 3:], axis1=1, axis2=2)
    assert variances[0] == 0.0
    assert variances[-1] > 2.0 * variances[REACH + 1] > 0.0
    T = se3.inverse(truth[0]) @ truth[-1]
    graph.add_loops([Loop(N - 1, 0, T, INFORMATION, EdgeKind.LOOP, CandidateSource.VIEW)])
    assert np.trace(graph.covariances()[-1, 3:, 3:]) < 0.5 * variances[-1]


def test_the_newest_keyframe_has_the_covariance_that_it_has_among_all():
    _, graph = graph_of(np.random.default_rng(2))
    newest = graph.uncertainty.newest(graph.components.in_use(), graph.T_map_camera)
    np.testing.assert_allclose(newest.covariance, graph.covariances()[-1], atol=1e-12)


def test_a_culled_keyframe_is_as_certain_as_its_anchor():
    _, graph = graph_of(np.random.default_rng(3))
    before = graph.covariances()
    graph.cull({20: 19}, max_edges=20)
    after = graph.covariances()
    carried = se3.adjoint(se3.inverse(graph.poses()[20]) @ graph.poses()[19])
    own = np.diag(np.repeat(graph.uncertainty.edge_variances(), 3))
    np.testing.assert_allclose(after[20], carried @ after[19] @ carried.T + own, atol=1e-12)
    assert np.isfinite(after).all()
    assert np.trace(after[20]) < 4.0 * np.trace(before[20])


def test_without_edges_the_covariance_of_odometry_adds_up():
    graph = MapGraph(registry.build("backends", "gtsam"))
    own = np.diag([1e-6] * 3 + [1e-4] * 3)
    for k in range(5):
        T = se3.pose(np.eye(3), [0.0, 0.0, 0.1 * k])
        graph.add_keyframe(Keyframe(k, k, float(k), T, EMPTY, None, step_covariance=own))
    np.testing.assert_allclose(np.diag(graph.covariances()[4])[:3], 4e-6)
    assert graph.covariances()[4][5, 5] == pytest.approx(4e-4)


def test_a_frame_is_uncertain_along_what_nothing_holds():
    keyframe = Keyframe(0, 0, 0.0, np.eye(4), EMPTY, None)
    known = PoseUncertainty(keyframe, np.diag([1e-6] * 3 + [1e-4] * 3), np.array([1e-6, 1e-4]))
    sideways = np.eye(6)[:, [3]]  # of a tangent, rotation first
    variances = np.diag(known.of_frame(se3.exp(np.full(6, 0.01)), sideways))
    assert variances[0] == pytest.approx(OPEN_VARIANCE, rel=1e-3)
    assert (variances[1:3] < 1e-3).all()
    assert (variances[3:] < 1e-5).all()


def test_of_several_links_the_shortest_counts():
    links = Links(np.array([0, 0, 2, 1]), np.array([1, 1, 1, 2]), np.array([3.0, 1.0, 5.0, 4.0]), 4)
    lengths, before = links.paths_from(0)
    assert lengths.tolist() == [0.0, 1.0, 5.0, np.inf]
    assert before[1:3].tolist() == [0, 1]
    assert [links.between(0, 1), links.between(1, 0), links.between(1, 2)] == [1, 1, 3]
