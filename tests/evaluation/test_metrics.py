import numpy as np
import pytest

from slam_bof import evaluation
from slam_bof.geometry import se3
from slam_bof.types import CandidateSource, Loop, Pose, Trajectory


def wander(n: int, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    steps = se3.exp(rng.normal(scale=0.05, size=(n, 6)))
    poses = [np.eye(4)]
    for step in steps[1:]:
        poses.append(poses[-1] @ step)
    return Trajectory(np.arange(n) / 30.0, np.array(poses))


def disturb(trajectory: Trajectory, scale: float, seed: int = 1) -> Trajectory:
    rng = np.random.default_rng(seed)
    noise = se3.exp(rng.normal(scale=scale, size=(len(trajectory), 6)))
    return Trajectory(trajectory.stamps_s, trajectory.poses @ noise)


def moved(trajectory: Trajectory, T_b_a: Pose) -> Trajectory:
    return Trajectory(trajectory.stamps_s, T_b_a @ trajectory.poses)


def without(trajectory: Trajectory, unknown: list[int]) -> Trajectory:
    poses = trajectory.poses.copy()
    poses[unknown] = np.nan
    return Trajectory(trajectory.stamps_s, poses)


def loop(query_id: int, match_id: int, T_match_query: Pose, kind: str = "loop") -> Loop:
    return Loop(query_id, match_id, T_match_query, np.eye(6), kind, CandidateSource.BAG)


def test_associate_pairs_by_time_within_the_limit() -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    reference = Trajectory(np.array([0.0, 0.1, 0.2, 0.3, 0.4]), poses)
    estimate = Trajectory(np.array([-1.0, 0.104, 0.196, 0.35, 0.4099]), poses)
    i, j = evaluation.associate(estimate, reference, 0.01)
    assert i.tolist() == [1, 2, 4]
    assert j.tolist() == [1, 2, 4]


def test_associate_asks_for_each_pose_of_the_shorter_trajectory() -> None:
    dense, sparse = wander(90), wander(3)
    sparse = Trajectory(np.array([0.5, 1.0, 2.0]), sparse.poses)
    assert [x.tolist() for x in evaluation.associate(sparse, dense)] == [[0, 1, 2], [15, 30, 60]]
    assert [x.tolist() for x in evaluation.associate(dense, sparse)] == [[15, 30, 60], [0, 1, 2]]


def test_associate_leaves_unknown_truth_out() -> None:
    truth = without(wander(5), [0, 3])
    assert [x.tolist() for x in evaluation.associate(wander(5), truth)] == [[1, 2, 4]] * 2
    for empty in (Trajectory(), without(wander(5), list(range(5)))):
        assert [len(x) for x in evaluation.associate(wander(5), empty)] == [0, 0]
    assert [len(x) for x in evaluation.associate(Trajectory(), wander(5))] == [0, 0]


def test_ate_is_zero_however_the_world_is_turned() -> None:
    truth = wander(100)
    T = se3.exp(np.array([1.0, 2.0, -1.0, 5.0, 6.0, 7.0]))
    stats = evaluation.ate(moved(truth, T), truth)
    assert stats is not None
    assert stats.max_m == pytest.approx(0.0, abs=1e-12)
    assert stats.n == 100
    aligned = evaluation.align_trajectory(moved(truth, T), truth)
    np.testing.assert_allclose(aligned, se3.inverse(T), atol=1e-12)


def test_ate_of_a_known_disturbance() -> None:
    # Opposite corners of a square pushed out and in leave the best alignment as it was.
    square = np.array([[1.0, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]])
    out = square * np.array([1.1, 0.9, 1.1, 0.9])[:, None]
    poses = np.tile(np.eye(4), (4, 1, 1))
    truth, estimate = poses.copy(), poses.copy()
    truth[:, :3, 3], estimate[:, :3, 3] = square, out
    stamps_s = np.arange(4.0)
    stats = evaluation.ate(Trajectory(stamps_s, estimate), Trajectory(stamps_s, truth))
    error_m = 0.1 * np.sqrt(2.0)
    assert stats is not None
    for value in (stats.rmse_m, stats.mean_m, stats.median_m, stats.max_m):
        assert value == pytest.approx(error_m)


def test_ate_and_rpe_skip_frames_of_unknown_truth() -> None:
    truth = wander(60)
    wild = truth.poses.copy()
    wild[10, :3, 3] += 1000.0
    estimate = Trajectory(truth.stamps_s, wild)
    stats = evaluation.ate(estimate, without(truth, [10]))
    assert stats is not None
    assert stats.max_m < 1e-12
    assert stats.n == 59
    assert evaluation.rpe(estimate, without(truth, [10])) == pytest.approx(0.0, abs=1e-12)


def test_rpe_is_the_drift_over_a_number_of_frames() -> None:
    truth = wander(100)
    drift = np.tile(np.eye(4), (100, 1, 1))
    drift[:, 0, 3] = 0.002 * np.arange(100)
    still = Trajectory(truth.stamps_s, np.tile(np.eye(4), (100, 1, 1)))
    drifting = Trajectory(truth.stamps_s, drift)
    assert evaluation.rpe(drifting, still) == pytest.approx(0.06)
    assert evaluation.rpe(drifting, still, 10) == pytest.approx(0.02)


def test_rpe_by_its_definition() -> None:
    truth = wander(40)
    estimate = disturb(truth, 0.1)
    errors_m = []
    for a in range(35):
        P, Q = estimate.poses, truth.poses
        E = np.linalg.inv(np.linalg.inv(Q[a]) @ Q[a + 5]) @ np.linalg.inv(P[a]) @ P[a + 5]
        errors_m.append(np.linalg.norm(E[:3, 3]))
    expected = np.sqrt(np.mean(np.square(errors_m)))
    assert evaluation.rpe(estimate, truth, 5) == pytest.approx(expected, rel=1e-12)


def test_what_cannot_be_known_is_none() -> None:
    truth = wander(40)
    assert evaluation.ate(Trajectory(), truth) is None
    assert evaluation.ate(wander(2), truth) is None
    assert evaluation.align_trajectory(wander(2), truth) is None
    assert evaluation.rpe(wander(30), truth, 30) is None
    assert evaluation.rpe(wander(31), truth, 30) is not None
    assert evaluation.loop_precision([], [0], truth) is None
    assert evaluation.loop_precision([], [], None) is None
    assert evaluation.loop_recall([], [], truth) is None
    assert evaluation.loop_recall([], [0, 9], None) is None
    assert evaluation.loop_recall([], [0, 9], truth) is None
    assert evaluation.scene_accuracy(["a"], None) is None
    assert evaluation.scene_accuracy([None], ["a"]) is None
    assert evaluation.scene_accuracy(["a"], [None]) is None
    nothing = np.zeros((2, 2), bool)
    assert evaluation.retrieval_metrics(np.ones((2, 2)), nothing, ~nothing) is None


def test_loop_errors_and_precision() -> None:
    truth = wander(200)
    keyframes = [0, 50, 120, 199]
    T_0_2 = se3.inverse(truth.poses[0]) @ truth.poses[120]
    off_by_9_cm = T_0_2 @ se3.exp(np.array([0, 0, 0, 0.09, 0, 0]))
    off_by_11_cm = T_0_2 @ se3.exp(np.array([0, 0, 0, 0, 0.11, 0]))
    off_by_6_deg = T_0_2 @ se3.exp(np.array([0, 0, np.radians(6.0), 0, 0, 0]))
    loops = [loop(2, 0, T) for T in (T_0_2, off_by_9_cm, off_by_11_cm, off_by_6_deg)]
    errors = evaluation.loop_errors(loops, keyframes, truth)
    np.testing.assert_allclose(errors[:, 0], [0, 0.09, 0.11, 0], atol=1e-12)
    np.testing.assert_allclose(errors[:, 1], [0, 0, 0, np.radians(6.0)], atol=1e-12)
    assert evaluation.loop_precision(loops, keyframes, truth) == 0.5
    T = se3.exp(np.array([0.1, 1.0, -2.0, 3.0, 0.0, 1.0]))
    assert evaluation.loop_precision(loops, keyframes, moved(truth, T)) == 0.5


def test_loops_of_unknown_truth_do_not_count() -> None:
    truth = without(wander(200), [50])
    keyframes = [0, 50, 120]
    T_0_2 = se3.inverse(truth.poses[0]) @ truth.poses[120]
    loops = [loop(2, 0, T_0_2), loop(2, 1, np.eye(4))]
    errors = evaluation.loop_errors(loops, keyframes, truth)
    assert np.isnan(errors).any(axis=1).tolist() == [False, True]
    assert evaluation.loop_precision(loops, keyframes, truth) == 1.0
    assert evaluation.loop_precision(loops[1:], keyframes, truth) is None


def there_and_back(angle_rad: float) -> Trajectory:
    """Walk 3 m along x in 100 frames and back in 100, turned by an angle on the way back."""
    x = np.concatenate([np.linspace(0, 3, 100), np.linspace(3, 0, 100)])
    tangents = np.zeros((200, 6))
    tangents[100:, 1] = angle_rad
    poses = se3.exp(tangents)
    poses[:, 0, 3] = x
    return Trajectory(np.arange(200) / 30.0, poses)


def test_revisits_are_near_in_place_and_angle_but_not_in_time() -> None:
    truth = there_and_back(np.radians(20.0))
    keyframes = range(0, 200, 10)
    back = evaluation.revisits(keyframes, truth)
    # Frame i comes back to frame 199 - i, 100 frames older from about 150 on; 0.3 m is 10 frames.
    assert np.flatnonzero(back).tolist() == [15, 16, 17, 18, 19]
    turned_away = there_and_back(np.radians(30.0))
    assert not evaluation.revisits(keyframes, turned_away).any()
    assert not evaluation.revisits(keyframes, without(truth, list(range(150, 200)))).any()


def test_loop_recall_is_the_share_of_revisits_with_a_loop() -> None:
    truth = there_and_back(0.0)
    keyframes = range(0, 200, 10)
    loops = [loop(16, 3, np.eye(4)), loop(19, 0, np.eye(4)), loop(16, 4, np.eye(4))]
    near = [loop(17, 16, np.eye(4), kind="covisibility")]
    assert evaluation.loop_recall(loops + near, keyframes, truth) == pytest.approx(2 / 5)
    assert evaluation.loop_recall([], keyframes, truth) == 0.0


def test_scene_accuracy_counts_known_truth() -> None:
    predicted = ["a", "b", None, "a"]
    assert evaluation.scene_accuracy(predicted, ["a", "a", "a", None]) == pytest.approx(1 / 3)
    with pytest.raises(ValueError, match="zip"):
        evaluation.scene_accuracy(predicted, ["a"])


def test_recall_at_k_grows_with_k() -> None:
    scores = np.array([[0.1, 0.5, 0.9, 0.2], [0.9, 0.6, 0.5, 0.1], [0.9, 0, 0, 0], [0, 0, 0, 0]])
    relevant = np.zeros((4, 4), bool)
    relevant[0, 3] = relevant[1, [2, 3]] = True
    metrics = evaluation.retrieval_metrics(scores, relevant, np.ones((4, 4), bool), (1, 2, 3))
    assert metrics is not None
    assert metrics.n_queries == 2
    assert list(metrics.recall_at.values()) == [0.0, 0.0, 1.0]


def test_confusion_has_the_truth_in_its_rows() -> None:
    counts = evaluation.confusion(["a", "b", "b"], ["a", "a", "b"], ["a", "b"])
    assert counts.tolist() == [[1, 1], [0, 1]]


def test_errors_as_large_as_covariances_say_have_a_nees_of_one():
    rng = np.random.default_rng(0)
    covariance = np.diag([1e-4, 2e-4, 1e-4, 4e-4, 1e-4, 1e-4])
    truth = np.array([se3.exp(rng.normal(0.0, 1.0, 6)) for _ in range(400)])
    errors = rng.multivariate_normal(np.zeros(6), covariance, 400)
    estimate = np.array([T @ se3.exp(e) for T, e in zip(truth, errors, strict=True)])
    covariances = np.repeat(covariance[None], 400, axis=0)
    assert evaluation.nees(estimate, truth, covariances) == pytest.approx(1.0, rel=0.1)
    assert evaluation.nees(estimate, truth, 4.0 * covariances) == pytest.approx(0.25, rel=0.1)
    truth[5:] = np.nan
    assert evaluation.nees(estimate, truth, covariances) is not None
    truth[:] = np.nan
    assert evaluation.nees(estimate, truth, covariances) is None
