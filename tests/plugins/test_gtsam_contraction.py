import gtsam
import numpy as np
import pytest
from pose_graphs import EMPTY, N, add_keyframes, circle, error_m, loop

from slam_bof.geometry import se3
from slam_bof.types import Keyframe
from slam_bof_plugins.backend_gtsam import GtsamBackend
from slam_bof_plugins.gtsam_contraction import Attachment, Contraction
from slam_bof_plugins.gtsam_selection import Edge


@pytest.fixture
def twice_round():
    """Twice round the circle, with a loop of each node to that of the round before."""
    truth, odometry = circle()
    truth, odometry = (np.concatenate([T, T[-1] @ T[1:]]) for T in (truth, odometry))
    backend = GtsamBackend()
    add_keyframes(backend, odometry)
    for i in range(N + 1):
        backend.add_loop(loop(truth, N + i, i))
    backend.update()
    return backend, truth, odometry


def contracted(backend, max_edges=10):
    """Contract the nodes of the second round but the newest; return the ids that stay."""
    backend.contract({k: k - N for k in range(N + 1, 2 * N)}, max_edges)
    backend.update()
    return [*range(N + 1), 2 * N]


def test_contracted_nodes_are_gone_and_the_others_stay_where_they_are(twice_round, tmp_path):
    backend, truth, odometry = twice_round
    before = backend.poses()
    stay = contracted(backend)
    assert backend.poses().shape == (N + 2, 4, 4)
    drift_m = error_m(odometry, truth)
    assert error_m(backend.poses(), before[stay]) < 0.2 * drift_m
    weights = backend.optimize()
    assert weights.tolist() == pytest.approx([1.0] * (N + 1))  # of all loops ever added
    assert error_m(backend.poses(), truth[stay]) < 0.2 * drift_m
    backend.write_g2o(tmp_path / "graph.g2o")
    lines = (tmp_path / "graph.g2o").read_text().splitlines()
    nodes = [int(line.split()[1]) for line in lines if line.startswith("VERTEX")]
    assert nodes == stay
    T = odometry[-1] @ se3.inverse(odometry[0]) @ odometry[1]
    newest = backend.poses()[-1]
    backend.add_keyframe(Keyframe(2 * N + 1, 2 * N + 1, 99.0, T, EMPTY, None))
    backend.update()
    step = se3.inverse(odometry[0]) @ odometry[1]
    np.testing.assert_allclose(backend.poses()[-1], newest @ step, atol=5e-3)


def test_a_loop_that_a_contracted_node_closed_stays_closed():
    """Nodes 1 and N - 1 are linked by loops of node N alone, which goes to node 0."""
    truth, odometry = circle()
    backend = GtsamBackend()
    add_keyframes(backend, odometry)
    backend.add_loop(loop(truth, N, 0))
    backend.update()
    add = se3.inverse(odometry[0]) @ odometry[1]
    backend.add_keyframe(Keyframe(N + 1, N + 1, 50.0, odometry[N] @ add, EMPTY, None))
    backend.update()
    before = backend.poses()
    backend.contract({N: 0}, 10)
    backend.update()
    backend.optimize()
    assert error_m(backend.poses()[:N], before[:N]) < 0.05
    closing = se3.inverse(backend.poses()[0]) @ backend.poses()[N - 1]
    true = se3.inverse(truth[0]) @ truth[N - 1]
    assert np.linalg.norm((closing - true)[:3, 3]) < 0.05
    assert np.linalg.norm((se3.inverse(odometry[0]) @ odometry[N - 1] - true)[:3, 3]) > 0.1


def test_a_node_keeps_a_limited_number_of_composed_edges(twice_round, tmp_path):
    backend, truth, _ = twice_round
    for k in range(N + 1, 2 * N):
        for back in (2, 3, 4, 5):
            backend.add_loop(loop(truth, k, k - N - back if k - N >= back else k - back))
    backend.update()
    contracted(backend, max_edges=3)
    backend.write_g2o(tmp_path / "graph.g2o")
    lines = (tmp_path / "graph.g2o").read_text().splitlines()
    pairs = [tuple(map(int, x.split()[1:3])) for x in lines if x.startswith("EDGE")]
    far = [pair for pair in pairs if abs(pair[0] - pair[1]) > 1]
    counts = np.bincount(np.array(far).ravel())
    assert 3 <= counts.max() <= 5
    assert len(set(pairs)) == len(pairs) == len({frozenset(pair) for pair in pairs})


def test_wrong_loops_are_left_out_of_a_contracted_graph_too(twice_round):
    backend, truth, _ = twice_round
    contracted(backend)
    backend.add_loop(loop(truth, 2 * N, 5, wrong=se3.pose(np.eye(3), [0.8, 0.0, 0.5])))
    backend.update()
    weights = backend.optimize()
    assert (weights >= 0.5).tolist() == [True] * (N + 1) + [False]
    assert error_m(backend.poses()[:N], truth[:N]) < 0.1


def test_an_edge_that_the_map_contradicts_hardly_counts_beside_another(twice_round):
    backend, truth, _ = twice_round
    backend.add_loop(loop(truth, N + 4, 9, wrong=se3.pose(np.eye(3), [0.3, 0.0, 0.2])))
    backend.add_loop(loop(truth, N + 4, 9))
    backend.update()
    contracted(backend)
    weights = backend.optimize()
    assert len(weights) == N + 3
    edges = {edge[:2]: edge.measured.matrix() for edge, _ in backend._inherited}
    true = se3.inverse(truth[9]) @ truth[4]
    assert np.linalg.norm((edges[9, 4] - true)[:3, 3]) < 0.02


def contraction(gone):
    return Contraction(gone, [], max_edges=10, max_trace=1e9)


def test_covariances_of_composed_poses_add_up():
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([3.0, 3.0, 3.0, 0.3, 0.3, 0.3]))
    here = gtsam.Pose3()
    found = contraction({1: Attachment(7, here, np.diag([1 / 16.0] * 3 + [1 / 0.16] * 3))})
    found.compose(Edge(1, 2, here), noise)
    found.compose(Edge(3, 1, here), noise)
    for edge, composed in found.inherited:
        assert 7 in edge[:2]
        np.testing.assert_allclose(composed.covariance(), np.diag([25.0] * 3 + [0.25] * 3))
    wall = gtsam.noiseModel.Gaussian.Information(np.diag([1.0, 1.0, 0.0, 0.0, 0.0, 1.0]))
    found.compose(Edge(1, 4, here), wall)
    information = found.inherited[-1][1].information()
    np.testing.assert_allclose(np.diag(information)[2:5], 0.0, atol=1e-12)
    assert np.diag(information)[0] == pytest.approx(1 / 17.0)


def test_edges_between_the_same_nodes_are_averaged_by_information():
    there = [gtsam.Pose3(gtsam.Rot3(), [x_m, 0.0, 0.0]) for x_m in (1.0, 1.3)]
    certain, vague = (gtsam.noiseModel.Isotropic.Sigma(6, sigma) for sigma in (0.1, 0.2))
    found = contraction({1: Attachment(7, gtsam.Pose3(), 1e12 * np.eye(6))})
    found.compose(Edge(1, 2, there[0]), certain)
    found.compose(Edge(2, 1, there[1].inverse()), vague)
    ((edge, noise),) = found.inherited
    assert edge[:2] == (7, 2)
    np.testing.assert_allclose(edge.measured.matrix()[:3, 3], [1.06, 0.0, 0.0], atol=1e-6)
    assert noise.information()[3, 3] == pytest.approx(125.0, rel=1e-3)
    limited = Contraction({}, found.inherited, max_edges=10, max_trace=6.0)
    limited.compose(Edge(7, 2, there[0]), certain)
    assert np.trace(limited.inherited[0][1].information()) == pytest.approx(6.0)
