"""How precise odometry is beside edges between keyframes, of motion that is known."""

import numpy as np
import pytest

from slam_bof.core import registry
from slam_bof.geometry import se3
from slam_bof.slam.frame_history import FrameHistory
from slam_bof.slam.odometry_noise import OdometryNoise
from slam_bof.slam.pose_graph import MapGraph
from slam_bof.types import Bag, CandidateSource, EdgeKind, FramePose, Keyframe, Loop

N = 60
REACH = 4
"""Each keyframe has an edge to as many before it."""
EMPTY = Bag(np.empty(0, np.int32), np.empty(0, np.float32))


def noisy(rng, T, rad, m):
    return T @ se3.exp(np.repeat([rad, m], 3) * rng.standard_normal(6))


def motion(rng):
    """Return true poses (N, 4, 4) of a camera that wanders about."""
    step = se3.exp(np.array([0.0, 0.1, 0.0, 0.05, 0.0, 0.2]))
    truth = [np.eye(4)]
    for _ in range(N - 1):
        truth.append(noisy(rng, truth[-1] @ step, 0.05, 0.05))
    return np.array(truth)


def odometry_of(rng, truth, walk=(0.0, 0.0), pose=(0.0, 0.0)):
    """Return odometry whose steps, and each of whose poses, are off by noise in rad and m."""
    odometry = [truth[0]]
    for step in se3.inverse(truth[:-1]) @ truth[1:]:
        odometry.append(odometry[-1] @ noisy(rng, step, *walk))
    return np.array([noisy(rng, T, *pose) for T in odometry])


def edges_of(rng, truth, sigma=(0.005, 0.01), view=(0.0, 0.0)):
    """Return edges (match, query, T_match_query): each is off, and so is what each view shows."""
    seen = np.array([noisy(rng, T, *view) for T in truth])
    return [
        (i, k, noisy(rng, se3.inverse(seen[i]) @ seen[k], *sigma))
        for k in range(len(truth))
        for i in range(max(0, k - REACH), k)
    ]


def relative_sigmas(odometry, edges):
    noise = OdometryNoise()
    for k, T in enumerate(odometry):
        noise.add_keyframe(k, T)
    for edge in edges:
        noise.add_edge(*edge)
    noise.learn()
    return noise.relative_sigmas()


@pytest.mark.parametrize("view", [(0.0, 0.0), (0.005, 0.01)])
def test_exact_odometry_is_far_more_precise_than_noisy_edges(view):
    rng = np.random.default_rng(0)
    truth = motion(rng)
    found = relative_sigmas(odometry_of(rng, truth), edges_of(rng, truth, view=view))
    # The camera turns too unsteadily to tell the noise of views from that of odometry's poses.
    assert found[0] < (0.4 if view == (0.0, 0.0) else 2.0)
    assert found[1] < 0.4


@pytest.mark.parametrize(
    ("walk", "pose"),
    [((0.02, 0.04), (0.0, 0.0)), ((0.0, 0.0), (0.02, 0.04)), ((0.01, 0.02), (0.01, 0.03))],
)
def test_noisy_odometry_is_less_precise_than_edges(walk, pose):
    rng = np.random.default_rng(1)
    truth = motion(rng)
    found = relative_sigmas(odometry_of(rng, truth, walk, pose), edges_of(rng, truth))
    assert (found > 2.5).all()


def drifting_to_one_side(truth, drift):
    """Return odometry whose every step is off by the same tangent (6,)."""
    odometry = [truth[0]]
    for step in se3.inverse(truth[:-1]) @ truth[1:]:
        odometry.append(odometry[-1] @ step @ se3.exp(drift))
    return np.array(odometry)


def test_a_slow_drift_to_one_side_shows_in_long_edges():
    rng = np.random.default_rng(6)
    truth = motion(rng)
    short = edges_of(rng, truth)
    loops = [
        (i, i + 40, noisy(rng, se3.inverse(truth[i]) @ truth[i + 40], 0.005, 0.01))
        for i in range(0, 20, 2)
    ]
    drift = np.array([0.0, 0.0005, 0.0, 0.001, 0.0, 0.0])
    # A loop is off by 0.06 rad and 0.12 m, twelve times its noise, after 40 steps.
    odometry = drifting_to_one_side(truth, 3.0 * drift)
    assert (relative_sigmas(odometry, short) < 0.7).all()
    assert (relative_sigmas(odometry, short + loops) > 1.0).all()
    # By a third of that it is within what long edges may be off: as if it did not drift.
    for hardly in (drifting_to_one_side(truth, drift), truth):
        assert relative_sigmas(hardly, short + loops) == pytest.approx([0.7, 0.7])


def test_a_random_walk_is_measured():
    rng = np.random.default_rng(2)
    truth = motion(rng)
    edges = edges_of(rng, truth, sigma=(0.005, 0.01))
    found = relative_sigmas(odometry_of(rng, truth, walk=(0.01, 0.02)), edges)
    assert found == pytest.approx([2.0, 2.0], rel=0.5)


def test_the_order_of_an_edge_does_not_matter():
    rng = np.random.default_rng(3)
    truth = motion(rng)
    odometry, edges = odometry_of(rng, truth, walk=(0.01, 0.02)), edges_of(rng, truth)
    turned = [(k, i, se3.inverse(T)) for i, k, T in edges]
    assert relative_sigmas(odometry, turned) == pytest.approx(relative_sigmas(odometry, edges))


def test_of_few_edges_nothing_is_known():
    rng = np.random.default_rng(4)
    truth = motion(rng)
    assert relative_sigmas(truth, edges_of(rng, truth)[:12]) is None


def graph_of(truth, odometry, edges, *, follows=False):
    """Return the graph where tracking follows odometry, or else the edges from one to the next."""
    graph = MapGraph(registry.build("backends", "gtsam"), is_tracked=True)
    steps = {k: T for i, k, T in edges if i == k - 1}
    T_track = truth[0]
    for k, T_odom_raw in enumerate(odometry):
        T_track = T_odom_raw if follows else T_track @ steps.get(k, np.eye(4))
        graph.add_keyframe(Keyframe(k, k, float(k), T_track, EMPTY, None, T_odom_raw=T_odom_raw))
        graph.add_loops(
            Loop(k, i, T, 1000.0 * np.eye(6), EdgeKind.COVISIBILITY, CandidateSource.PROXIMITY)
            for i, query, T in edges
            if query == k
        )
    return graph


def optimized(truth, odometry, edges, *, follows=False):
    graph = graph_of(truth, odometry, edges, follows=follows)
    graph.optimize()
    return graph.poses()


def test_odometry_is_trusted_if_it_drifts_slowly_but_not_if_its_steps_are_noisy():
    rng = np.random.default_rng(8)
    truth = motion(rng)
    edges = edges_of(rng, truth)
    drift = se3.exp(np.outer(np.arange(N), [0.0, 1e-3, 0.0, 2e-3, 0.0, 0.0]))
    assert graph_of(truth, truth @ drift, edges).trusts_odometry(0)
    assert not graph_of(truth, odometry_of(rng, truth, (0.02, 0.04)), edges).trusts_odometry(0)
    assert not graph_of(truth, truth, edges[:12]).trusts_odometry(0)
    assert not graph_of(truth, truth, edges).trusts_odometry(1)


def worst_m(poses, truth):
    return np.linalg.norm((poses - truth)[:, :3, 3], axis=1).max()


def test_exact_odometry_is_hardly_touched_and_a_drifting_one_is_corrected():
    rng = np.random.default_rng(5)
    truth = motion(rng)
    edges = edges_of(rng, truth)
    drifting = odometry_of(rng, truth, walk=(0.03, 0.05))
    of_drifting, of_exact = (optimized(truth, T, edges) for T in (drifting, truth))
    assert worst_m(of_exact, truth) < 0.01
    assert worst_m(of_exact, truth) < 0.1 * worst_m(of_drifting, truth)
    assert worst_m(of_drifting, truth) < 0.3 * worst_m(drifting, truth)


def test_where_edges_err_alike_tracking_tells_that_odometry_does_not():
    """Such edges look as if odometry drifted: the depth of a phone bends all walls alike."""
    rng = np.random.default_rng(13)
    truth = motion(rng)
    bias = se3.exp(np.array([0.0, 0.01, 0.0, 0.02, 0.0, 0.0]))
    edges = [(i, k, T @ bias) for i, k, T in edges_of(rng, truth)]
    assert (relative_sigmas(truth, edges) > 1.0).all()
    following, others = (optimized(truth, truth, edges, follows=f) for f in (True, False))
    assert worst_m(following, truth) < 0.6 * worst_m(others, truth)


@pytest.mark.parametrize("seed", [10, 11, 12])
def test_where_too_few_edges_tell_the_steps_of_tracking_count_like_edges(seed):
    """Tracking, which knows odometry by frames, has kept it exact."""
    rng = np.random.default_rng(seed)
    truth = motion(rng)[:8]
    graph = MapGraph(registry.build("backends", "gtsam"), is_tracked=True)
    edges = [edge for edge in edges_of(rng, truth) if edge[1] > edge[0] + 1]
    for k, T in enumerate(truth):
        graph.add_keyframe(Keyframe(k, k, float(k), T, EMPTY, None, T_odom_raw=T))
        graph.add_loops(
            Loop(k, i, T_i_k, 1000.0 * np.eye(6), EdgeKind.COVISIBILITY, CandidateSource.PROXIMITY)
            for i, query, T_i_k in edges
            if query == k
        )
    by_edges_m = worst_m(graph.poses(), truth)
    graph.optimize()
    assert worst_m(graph.poses(), truth) < 0.85 * by_edges_m


def test_wrong_edges_do_not_hide_how_precise_odometry_is():
    rng = np.random.default_rng(9)
    truth = motion(rng)
    edges = [
        (i, k, noisy(rng, T, 0.1, 0.3) if n % 6 == 0 else T)
        for n, (i, k, T) in enumerate(edges_of(rng, truth))
    ]
    assert (relative_sigmas(truth, edges) < 1.0).all()


@pytest.mark.parametrize("walk", [(0.0, 0.0), (0.005, 0.01)])
def test_where_odometry_slips_tracking_is_followed(walk):
    rng = np.random.default_rng(10)
    truth = motion(rng)
    edges = [edge for edge in edges_of(rng, truth) if edge[0] == edge[1] - 1 or edge[1] < 20]
    odometry = odometry_of(rng, truth, walk)
    slipped = odometry.copy()
    slipped[40:, 0, 3] += 0.6
    of_odometry, of_slipped = (optimized(truth, T, edges) for T in (odometry, slipped))
    assert worst_m(of_slipped, truth) < worst_m(of_odometry, truth) + 0.05


def test_frames_move_as_odometry_or_tracking_has_them_whichever_is_nearer_to_the_map():
    raw = np.tile(np.eye(4), (5, 1, 1))
    raw[:, 2, 3] = np.arange(5) * 0.1
    tracked = raw.copy()
    tracked[1::2, 0, 3] = 0.02
    history = FrameHistory(
        FramePose(float(k), *poses, 0) for k, poses in enumerate(zip(raw, tracked, strict=True))
    )
    at = [0, 3, 4]
    keyframes = [Keyframe(k, i, float(i), tracked[i], EMPTY, None) for k, i in enumerate(at)]
    for expected in (raw, tracked):
        poses = history.trajectory(keyframes, expected[at]).poses
        assert poses == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("last_digit", [-1e-12, 0.0, 1e-12])
def test_frames_move_as_odometry_where_tracking_is_as_near_to_the_map(last_digit):
    raw = np.tile(np.eye(4), (5, 1, 1))
    raw[:, 2, 3] = np.arange(5) * 0.1
    tracked = raw.copy()
    tracked[1, 0, 3] = 0.02  # of no keyframe
    tracked[4, 2, 3] += last_digit
    frames = zip(raw, tracked, strict=True)
    history = FrameHistory(FramePose(float(k), *poses, 0) for k, poses in enumerate(frames))
    at = [0, 2, 4]
    keyframes = [Keyframe(k, i, float(i), tracked[i], EMPTY, None) for k, i in enumerate(at)]
    optimised = raw[at].copy()
    optimised[1:, 2, 3] += 0.001
    found = history.trajectory(keyframes, optimised).poses
    assert np.abs(found[:, 0, 3]).max() < 1e-9


def test_what_was_learnt_of_forgotten_keyframes_stays():
    rng = np.random.default_rng(2)
    truth = motion(rng)
    odometry, edges = odometry_of(rng, truth, walk=(0.004, 0.008)), edges_of(rng, truth)
    noises = OdometryNoise(), OdometryNoise()
    for k, T in enumerate(odometry):
        for noise in noises:
            noise.add_keyframe(k, T)
            for i, query, T_match_query in edges:
                if query == k:
                    noise.add_edge(i, query, T_match_query)
        if k > REACH:
            noises[1].forget(k - REACH)
    assert sorted(noises[1].T_odom_camera) == [0, *range(N - REACH, N)]
    np.testing.assert_array_equal(noises[0].relative_sigmas(), noises[1].relative_sigmas())
    noises[1].add_edge(3, N - 1, np.eye(4))  # of a forgotten keyframe: says nothing
    np.testing.assert_array_equal(noises[0].relative_sigmas(), noises[1].relative_sigmas())


def test_of_one_keyframe_with_a_loop_to_an_earlier_session_nothing_is_known():
    graph = MapGraph(registry.build("backends", "gtsam"), is_tracked=True)
    for k in range(2):
        graph.add_keyframe(
            Keyframe(k, 0, 0.0, np.eye(4), EMPTY, None, session=k, T_odom_raw=np.eye(4))
        )
        graph.add_loops(
            Loop(1, 0, np.eye(4), 1000.0 * np.eye(6), EdgeKind.LOOP, CandidateSource.VIEW)
            for _ in range(k)
        )
    graph.optimize()
    np.testing.assert_allclose(graph.poses(), np.tile(np.eye(4), (2, 1, 1)), atol=1e-6)
