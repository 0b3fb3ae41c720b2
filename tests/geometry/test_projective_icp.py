import numpy as np
import pytest

from slam_bof.geometry import (
    AlignmentParams,
    DepthView,
    ViewAligner,
    make_view,
    point_to_plane,
    se3,
)
from slam_bof.types import DepthFrame, Intrinsics

ONE = np.array([0])


def upright(x, y, z, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.array([[s, 0, c, x], [-c, 0, s, y], [0, -1, 0, z], [0, 0, 0, 1.0]])


@pytest.fixture(scope="module")
def pair(look, standpoint):
    """Two views of the room's same corner, 35 cm and 17 degrees apart, and the true motion."""
    match = upright(*standpoint, 1.3, 0.8)
    query = upright(standpoint[0] + 0.3, standpoint[1] - 0.15, 1.4, 1.1)
    aligner = ViewAligner(AlignmentParams())
    for index, T in enumerate((match, query)):
        aligner.add(make_view(look(T, index)))
    return aligner, se3.inverse(match) @ query


def error(T_estimate, T_true):
    off = se3.inverse(T_true) @ T_estimate
    return np.linalg.norm(off[:3, 3]), np.degrees(se3.rotation_angle(off))


def test_the_motion_between_two_views_is_recovered(pair):
    aligner, T_match_query = pair
    T = aligner.align(1, ONE, np.eye(4)[None, None])
    distance_m, angle_deg = error(T[0], T_match_query)
    assert distance_m < 0.03
    assert angle_deg < 1.0


def test_a_good_start_among_bad_ones_is_enough(pair):
    aligner, T_match_query = pair
    bad = se3.exp(np.array([[0, np.pi, 0, 0, 0, 0], [0, 1.5, 0, 2, 0, 0]]))
    T = aligner.align(1, ONE, np.stack([*bad, T_match_query])[None])
    assert error(T[0], T_match_query)[0] < 0.03


def test_the_true_motion_agrees_and_wrong_ones_do_not(pair):
    aligner, T_match_query = pair
    closer = T_match_query @ se3.pose(np.eye(3), [0, 0, -0.5])
    inlier_ratio, free_space_violation, _ = aligner.agreement(
        1, np.zeros(2, int), np.stack([T_match_query, closer])
    )
    assert inlier_ratio[0] > 0.6
    assert free_space_violation[0] < 0.1
    assert inlier_ratio[1] < 0.4
    assert free_space_violation[1] > 0.4


def test_few_points_score_the_true_motion_best_from_either_side(pair):
    aligner, T_match_query = pair
    wrong = se3.exp(np.array([[0, 0.2, 0, 0, 0, 0], [0, 0, 0, 0, 0, -0.4], [0, 3.0, 0, 0, 0, 0]]))
    poses = np.concatenate([T_match_query[None], T_match_query @ wrong])
    scores = score_each(aligner, 1, 0, poses)
    assert scores.argmax() == 0
    assert scores[0] > max(0.4, scores[1] + 0.1, scores[2] + 0.1)
    assert scores[3] <= 0.0  # they look away from each other
    back = score_each(aligner, 0, 1, se3.inverse(poses))
    np.testing.assert_allclose(back, scores, atol=1e-9)


def score_each(aligner, query, match, poses):
    """Score each pose by itself."""
    matches, bonus = np.array([match]), np.zeros(1)
    return np.array([aligner.rough_score(query, matches, T[None], bonus)[0] for T in poses])


@pytest.mark.parametrize("best", [0, 2])
def test_of_several_poses_of_a_pair_the_best_has_its_own_rough_score(pair, best):
    aligner, T_match_query = pair
    random = np.random.default_rng(0)
    poses = T_match_query @ se3.exp(0.1 * random.standard_normal((30, 6)))
    bonus = random.uniform(0.0, 0.2, len(poses))
    expected = score_each(aligner, 1, 0, poses) + bonus
    order = np.roll(np.argsort(-expected), best)
    found = aligner.rough_score(1, np.zeros(len(poses), int), poses[order], bonus[order])
    assert found.argmax() == best
    assert found.max() == pytest.approx(expected.max(), abs=1e-12)
    assert (found >= expected[order] - 1e-12).all()


def test_a_view_agrees_with_itself_altogether(pair):
    aligner, _ = pair
    agreement = aligner.agreement(1, np.array([1]), np.eye(4)[None])
    assert agreement.inlier_ratio.tolist() == [1.0]
    assert agreement.free_space_violation.tolist() == [0.0]
    assert agreement.visible_ratio.tolist() == [1.0]


def test_what_falls_outside_the_other_view_is_not_compared(pair):
    aligner, _ = pair
    turned = se3.exp(np.array([[0, yaw, 0, 0, 0, 0] for yaw in (0.4, np.pi)]))
    visible_ratio = aligner.agreement(1, np.array([1, 1]), turned).visible_ratio
    assert 0.3 < visible_ratio[0] < 0.9
    assert visible_ratio[1] == 0.0


def test_truncated_views_are_forgotten_and_replaced(look, standpoint):
    views = [make_view(look(upright(*standpoint, 1.3, yaw), 0)) for yaw in (0.0, 1.0, 2.0)]
    aligner = ViewAligner(AlignmentParams())
    aligner.truncate(1)  # of nothing
    assert len(aligner) == 0
    for view in views[:2]:
        aligner.add(view)
    aligner.truncate(1)
    aligner.add(views[2])
    assert len(aligner) == 2
    afresh = ViewAligner(AlignmentParams())
    for view in (views[0], views[2]):
        afresh.add(view)
    np.testing.assert_array_equal(aligner.points_camera(1), afresh.points_camera(1))


def test_pairs_do_not_depend_on_their_company(pair):
    aligner, T_match_query = pair
    starts = np.stack([T_match_query, np.eye(4)])[:, None]
    together = aligner.align(1, np.array([0, 1]), starts)
    np.testing.assert_allclose(together[:1], aligner.align(1, ONE, starts[:1]), atol=1e-4)
    np.testing.assert_allclose(together[1], np.eye(4), atol=1e-3)


def test_a_view_of_nothing_aligns_with_nothing(pair, look, standpoint):
    _, T_match_query = pair
    aligner = ViewAligner(AlignmentParams())
    camera = make_view(look(upright(*standpoint, 1.3, 0.8), 0)).intrinsics
    empty = np.zeros((camera.height, camera.width), np.float32)
    for _ in range(2):
        aligner.add(DepthView(empty, np.zeros((*empty.shape, 3), np.float32), camera))
    T = aligner.align(1, ONE, T_match_query[None, None])
    assert np.isfinite(T).all()
    assert aligner.agreement(1, ONE, T).inlier_ratio.tolist() == [0.0]
    assert aligner.points_camera(0).shape == (0, 3)


def test_points_are_kept(pair, look, standpoint):
    aligner, _ = pair
    view = make_view(look(upright(*standpoint, 1.3, 0.8), 0))
    expected = (view.rays() * view.depth_m[..., None])[view.depth_m > 0]
    np.testing.assert_allclose(aligner.points_camera(0), expected, rtol=1e-6)


def test_another_camera_is_refused(pair):
    camera = Intrinsics(160, 120, 130.0, 130.0, 80.0, 60.0)
    view = make_view(DepthFrame(0.0, np.full((120, 160), 2.0, np.float32), camera))
    with pytest.raises(ValueError, match=r"views must be of Intrinsics.*, got Intrinsics.*65\.0"):
        pair[0].add(view)


def test_few_points_first_lead_to_where_all_do(look, standpoint, pair):
    _, T_match_query = pair
    match = upright(*standpoint, 1.3, 0.8)
    views = [make_view(look(T, k)) for k, T in enumerate((match, match @ T_match_query))]
    start = T_match_query @ se3.exp(np.array([0.03, -0.04, 0.02, 0.06, 0.03, -0.05]))
    found = []
    for n_fine in (4, 12):
        params = {"n_points": 2000, "n_coarse_points": 300, "gates_m": (0.3, 0.03)}
        aligner = ViewAligner(AlignmentParams(n_fine_iterations=n_fine, **params))
        for view in views:
            aligner.add(view)
        found.append(aligner.refine(1, ONE, start[None])[0])
        assert error(found[-1], T_match_query)[0] < 0.02
    assert error(*found)[0] < 0.005


def test_pairs_that_rest_on_the_way_end_where_restless_ones_do(look, standpoint, pair):
    _, T_match_query = pair
    match = upright(*standpoint, 1.3, 0.8)
    views = [make_view(look(T, k)) for k, T in enumerate((match, match @ T_match_query))]
    far = T_match_query @ se3.exp(np.array([0.03, -0.04, 0.02, 0.06, 0.03, -0.05]))
    near = T_match_query @ se3.exp(np.full(6, 0.002))
    found = []
    for min_step in (0.0, AlignmentParams().min_step):
        aligner = ViewAligner(
            AlignmentParams(n_points=3000, n_iterations=15, gates_m=(0.3, 0.03), min_step=min_step)
        )
        for view in views:
            aligner.add(view)
        found.append(aligner.refine(1, np.array([0, 0, 1]), np.stack([far, near, np.eye(4)])))
    for restless, rested in zip(*found, strict=True):
        moved_m, turned_deg = error(rested, restless)
        assert moved_m < 0.004
        assert turned_deg < 0.1


@pytest.mark.parametrize("least", [1.0, 1e-2, 1e-9])
def test_steps_along_directions_with_little_information_are_shortened(least):
    random = np.random.default_rng(0)
    rows = random.standard_normal((20, 6)) * [1, 1, 1, 1, least, least] / 20
    information, right, step = rows.T @ rows, random.standard_normal(6), np.empty(6)
    assert point_to_plane._shortened_step(information, right, step)
    values, vectors = np.linalg.eigh(information)
    gains = values / (values**2 + point_to_plane.MIN_INFORMATION**2)
    np.testing.assert_allclose(step, vectors @ (gains * (vectors.T @ right)), rtol=1e-6, atol=1e-9)


def test_without_definite_information_there_is_no_step_by_triangular_factors():
    information = np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1e-3])
    step = np.ones(6)
    assert not point_to_plane._shortened_step(information, np.ones(6), step)
    assert step.tolist() == [0.0] * 6
