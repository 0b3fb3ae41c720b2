import gtsam
import numpy as np
import pytest
from pose_graphs import EMPTY, N, add_keyframes, circle, error_m, loop

from slam_bof.geometry import se3
from slam_bof.types import CandidateSource, EdgeKind, Keyframe, Loop
from slam_bof_plugins.backend_gtsam import GtsamBackend, GtsamParams


@pytest.fixture
def drifted():
    truth, odometry = circle()
    backend = GtsamBackend()
    add_keyframes(backend, odometry)
    return backend, truth, odometry


def test_without_loops_the_map_is_the_odometry(drifted):
    backend, _, odometry = drifted
    backend.optimize()
    np.testing.assert_allclose(backend.poses(), odometry, atol=1e-6)


def test_the_first_pose_need_not_be_the_identity():
    _, odometry = circle()
    start = se3.exp(np.array([0.3, 0.1, -0.2, 5.0, 1.0, -2.0]))
    backend = GtsamBackend()
    add_keyframes(backend, start @ odometry)
    np.testing.assert_allclose(backend.poses(), start @ odometry, atol=1e-6)


def test_loops_correct_drift_at_once_and_at_the_end(drifted):
    backend, truth, odometry = drifted
    before_m = error_m(odometry, truth)
    closed = slice(-2, None)
    for query_id, match_id in ((N, 0), (N - 1, 0), (N, 1)):
        backend.add_loop(loop(truth, query_id, match_id))
    backend.update()
    online_m = error_m(backend.poses()[closed], truth[closed])
    backend.optimize()
    assert online_m < 0.2 * before_m
    assert error_m(backend.poses()[closed], truth[closed]) < 0.2 * before_m
    assert error_m(backend.poses(), truth) < before_m


def test_a_wrong_loop_among_true_ones_bends_little(drifted):
    backend, truth, odometry = drifted
    for i in range(6):
        backend.add_loop(loop(truth, N - i, i))
    away = se3.pose(np.eye(3), [1.5, 0.0, 1.0])
    backend.add_loop(loop(truth, 12, 2, wrong=away))
    backend.update()
    backend.optimize()
    assert error_m(backend.poses(), truth) < error_m(odometry, truth)


@pytest.mark.parametrize("share", [0.1, 0.3, 0.5])
def test_wrong_loops_are_left_out_and_harm_nothing(share):
    """Wrong loops among as many again, or more, that are right: the outliers of issue reports."""
    truth, odometry = circle()
    truth, odometry = (np.concatenate([T, T[-1] @ T[1:]]) for T in (truth, odometry))  # twice round
    right = [loop(truth, N + i, i) for i in range(0, N, 2)]
    rng = np.random.default_rng(1)
    wrong = [
        loop(truth, N + 1 + k, 1 + k, wrong=se3.exp(rng.normal(0, 0.5, 6)))
        for k in range(round(share * len(right)))
    ]
    clean, outliers = GtsamBackend(), GtsamBackend()
    for backend, loops in ((clean, right), (outliers, wrong + right)):
        add_keyframes(backend, odometry)
        for found in loops:
            backend.add_loop(found)
        backend.update()
    assert clean.optimize().tolist() == pytest.approx([1.0] * len(right))
    weights = outliers.optimize()
    assert (weights < 0.5).tolist() == [True] * len(wrong) + [False] * len(right)
    np.testing.assert_allclose(outliers.poses(), clean.poses(), atol=1e-3)


def test_more_right_loops_outweigh_wrong_ones_that_agree():
    """Ten keyframes along one corridor that look like another: each agrees with the next."""
    truth, odometry = circle()
    truth, odometry = (np.concatenate([T, T[-1] @ T[1:]]) for T in (truth, odometry))
    right = [loop(truth, N + i, i) for i in range(12, N)]
    corridor = se3.pose(np.eye(3), [1.0, 0.0, 0.0])
    wrong = [loop(truth, N + i, i, wrong=corridor) for i in range(1, 5)]
    backend = GtsamBackend()
    add_keyframes(backend, odometry)
    for found in wrong + right:
        backend.add_loop(found)
        backend.update()
    assert (backend.optimize() < 0.5).tolist() == [True] * len(wrong) + [False] * len(right)
    assert error_m(backend.poses(), truth) < error_m(odometry, truth)


def test_a_local_error_that_neighbours_correct_does_not_reject_loops():
    truth, odometry = circle()
    truth, odometry = (np.concatenate([T, T[-1] @ T[1:]]) for T in (truth, odometry))
    slip = se3.exp(np.array([0.0, 0.3, 0.0, 0.2, 0.0, 0.2]))
    odometry[30:] = odometry[29] @ slip @ se3.inverse(odometry[29]) @ odometry[30:]
    backend = GtsamBackend()
    add_keyframes(backend, odometry, period_s=0.3)
    for query in (30, 31, 32):
        for match in (27, 28, 29):
            backend.add_loop(loop(truth, query, match))
    for i in range(N):
        backend.add_loop(loop(truth, N + i, i))
    backend.update()
    assert (backend.optimize() >= 0.5).mean() > 0.9
    assert error_m(backend.poses(), truth) < 0.2 * error_m(odometry, truth)


def test_selection_can_be_turned_off():
    truth, odometry = circle()
    backend = GtsamBackend(GtsamParams(select_loops=False))
    add_keyframes(backend, odometry)
    backend.add_loop(loop(truth, N, 0, wrong=se3.pose(np.eye(3), [2.0, 0.0, 0.0])))
    backend.update()
    assert backend.optimize().tolist() == [1.0]


def test_an_unobserved_direction_is_left_to_odometry():
    """A loop against a bare wall knows the distance to it, but nothing along it."""
    truth = np.array([np.eye(4), se3.pose(np.eye(3), [0.3, 0.0, 0.0])])
    backend = GtsamBackend()
    add_keyframes(backend, truth)
    wall = np.diag([1.0, 1.0, 1e-9, 1e-9, 1e-9, 1.0])
    slipped = se3.pose(np.eye(3), [0.2, 0.1, 0.05])
    backend.add_loop(loop(truth, 1, 0, information=wall, wrong=slipped))
    backend.update()
    moved = backend.poses()[1, :3, 3] - truth[1, :3, 3]
    assert abs(moved[2]) > 0.005
    assert np.abs(moved[:2]).max() < 1e-4


def test_g2o_has_translation_first_and_information_of_quaternions(drifted, tmp_path):
    backend, truth, _ = drifted
    information = np.diag([1.0, 2.0, 3.0, 40.0, 50.0, 60.0])
    backend.add_loop(loop(truth, N, 0, information=information))
    backend.update()
    backend.write_g2o(tmp_path / "graph.g2o")
    lines = (tmp_path / "graph.g2o").read_text().splitlines()
    nodes = [line.split() for line in lines if line.startswith("VERTEX_SE3:QUAT")]
    edges = [line.split() for line in lines if line.startswith("EDGE_SE3:QUAT")]
    assert len(nodes) == N + 1
    assert len(edges) == N + 1
    (closing,) = [e for e in edges if {e[1], e[2]} == {"0", str(N)}]
    upper = np.array(closing[10:], dtype=float)
    diagonal = upper[[0, 6, 11, 15, 18, 20]]
    np.testing.assert_allclose(diagonal / diagonal[3], [10, 12.5, 15, 1, 2, 3], rtol=1e-4)


def test_the_map_is_the_optimum_of_its_g2o_file(drifted, tmp_path):
    backend, truth, _ = drifted
    for k in range(6):
        backend.add_loop(loop(truth, N - k, (N - k) % 3))
    backend.update()
    backend.optimize()
    backend.write_g2o(tmp_path / "graph.g2o")
    graph, values = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    per_quaternion = np.array([0.5, 0.5, 0.5, 1.0, 1.0, 1.0])  # gtsam's reader does not convert
    factors = gtsam.NonlinearFactorGraph()
    for k in range(graph.size()):
        edge = graph.at(k)
        information = edge.noiseModel().information() * np.outer(per_quaternion, per_quaternion)
        noise = gtsam.noiseModel.Gaussian.Information(information)
        factors.add(gtsam.BetweenFactorPose3(*edge.keys(), edge.measured(), noise))
    held = gtsam.noiseModel.Isotropic.Sigma(6, 1e-6)
    factors.add(gtsam.PriorFactorPose3(0, values.atPose3(0), held))
    best = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    poses = np.array([best.atPose3(k).matrix() for k in range(N + 1)])
    np.testing.assert_allclose(poses, backend.poses(), atol=2e-3)


def test_almost_rotations_do_no_harm():
    _, odometry = circle()
    sheared = odometry.copy()
    sheared[:, :3, :3] += 1e-5 * np.random.default_rng(0).standard_normal((N + 1, 3, 3))
    backend = GtsamBackend()
    add_keyframes(backend, sheared)
    np.testing.assert_allclose(backend.poses(), odometry, atol=1e-3)


def test_errors_below_the_tolerance_do_not_add_up_while_frames_arrive():
    """Each step is off by less than the tolerance, and the edges beside it say so."""
    truth, odometry = circle()
    backend = GtsamBackend()
    for k, T in enumerate(odometry):
        backend.add_keyframe(Keyframe(k, k, float(k), T, EMPTY, None))
        for match_id in range(max(0, k - 2), k):
            backend.add_loop(loop(truth, k, match_id, kind="covisibility"))
        backend.update()
    assert error_m(odometry, truth) > 0.1
    assert error_m(backend.poses(), truth) < 0.005


@pytest.fixture
def restarted():
    """Twice round the circle, the second time by an odometry that was started anew."""
    truth, odometry = circle()
    truth = np.concatenate([truth, truth[-1] @ truth[1:]])
    elsewhere = se3.exp(np.array([0.3, 1.0, 0.2, 3.0, -1.0, 2.0]))
    anew = np.concatenate([odometry, elsewhere @ odometry[1:]])
    backend = GtsamBackend()
    for i, T in enumerate(anew):
        backend.add_keyframe(Keyframe(i, i, float(i), T, EMPTY, None, int(i > N)))
        backend.update()
    return backend, truth


def join(backend, truth, query_id, match_id):
    """What the closer does with the first loop between two parts."""
    poses = backend.poses()
    T_map_query = poses[match_id] @ se3.inverse(truth[match_id]) @ truth[query_id]
    T = T_map_query @ se3.inverse(poses[query_id])
    backend.move(np.arange(N + 1, len(poses)), T)


def test_a_lost_step_gives_way_to_a_loop(restarted):
    backend, truth = restarted
    join(backend, truth, N + 3, 3)
    for i in (3, 4, 5, 9):
        backend.add_loop(loop(truth, N + i, i))
    backend.update()
    assert np.linalg.norm((backend.poses()[N + 3] - backend.poses()[3])[:3, 3]) < 0.01
    assert (backend.optimize() >= 0.5).all()
    assert np.linalg.norm((backend.poses()[N + 3] - backend.poses()[3])[:3, 3]) < 0.01
    assert error_m(backend.poses(), truth) < 0.2


def test_one_loop_is_enough_to_hold_what_it_joined(restarted):
    """Where the part was carried to, the loop is no news; it must hold all the same."""
    backend, truth = restarted
    join(backend, truth, N + 3, 3)
    joined = backend.poses()
    backend.add_loop(loop(truth, N + 3, 3))
    backend.update()
    np.testing.assert_allclose(backend.poses(), joined, atol=0.02)


def test_a_wrong_loop_does_not_hold_a_part_that_right_ones_joined(restarted):
    backend, truth = restarted
    join(backend, truth, N + 3, 3)
    for i in (3, 4, 5, 9):
        backend.add_loop(loop(truth, N + i, i))
    backend.add_loop(loop(truth, N + 7, 7, wrong=se3.pose(np.eye(3), [1.5, 0.0, 0.5])))
    backend.update()
    assert (backend.optimize() >= 0.5).tolist() == [True, True, True, True, False]


def test_the_graph_goes_on_from_its_optimum_without_the_loops_left_out(drifted):
    backend, truth, odometry = drifted
    for k in range(1, 4):
        backend.add_loop(loop(truth, N - k, 4 - k))
    wrong = se3.pose(np.eye(3), [0.8, 0.0, 0.5])
    backend.add_loop(loop(truth, N, 6, wrong=wrong))
    backend.update()
    weights = backend.optimize()
    assert weights[-1] < 0.5
    optimum = backend.poses()
    step = se3.inverse(odometry[0]) @ odometry[1]
    for k in range(3):
        T = odometry[-1] @ np.linalg.matrix_power(step, k + 1)
        backend.add_keyframe(Keyframe(N + 1 + k, N + 1 + k, N + 1.0 + k, T, EMPTY, None))
        backend.update()
    np.testing.assert_allclose(backend.poses()[: N + 1], optimum, atol=2e-3)
    np.testing.assert_allclose(
        backend.poses()[-1], optimum[-1] @ np.linalg.matrix_power(step, 3), atol=2e-3
    )


def test_a_step_of_known_covariance_holds_against_a_loop_as_far_as_it_says():
    """A loop claims 0.1 m more than three steps of known or of unknown covariance add up to."""
    moved_m = []
    for covariance in (None, 1e-8 * np.eye(6)):
        backend = GtsamBackend()
        for k in range(4):
            T = np.eye(4)
            T[0, 3] = k
            keyframe = Keyframe(k, k, float(k), T, EMPTY, None, step_covariance=covariance)
            backend.add_keyframe(keyframe)
        T_loop = np.eye(4)
        T_loop[0, 3] = 3.1
        kind, source = EdgeKind.LOOP, CandidateSource.VIEW
        backend.add_loop(Loop(3, 0, T_loop, 1000.0 * np.eye(6), kind, source))
        backend.update()
        moved_m.append(backend.poses()[3][0, 3] - 3.0)
    assert moved_m[0] > 0.04
    assert abs(moved_m[1]) < 0.002


def test_what_a_partial_edge_leaves_open_speaks_against_nothing():
    """The edge is off by half a metre along z, along which it has no information."""
    backend = GtsamBackend()
    for k in range(4):
        T = np.eye(4)
        T[2, 3] = k
        backend.add_keyframe(Keyframe(k, k, float(k), T, EMPTY, None))
    T_partial = np.eye(4)
    T_partial[2, 3] = 2.5
    information = np.diag([1e3, 1e3, 1e3, 1e3, 1e3, 1e-3])
    kind, source = EdgeKind.PARTIAL, CandidateSource.PROXIMITY
    backend.add_loop(Loop(3, 0, T_partial, information, kind, source))
    backend.update()
    assert backend.optimize() == pytest.approx([1.0])
    assert backend.poses()[3][2, 3] == pytest.approx(3.0, abs=1e-3)
