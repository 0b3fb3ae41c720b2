import numpy as np
import pytest

from slam_bof.geometry import se3
from slam_bof.places import PlaceRecogniser, RecogniserParams
from slam_bof.types import DepthFrame

N_ROUND = 12


def upright(x, y, z, yaw, roll):
    c, s = np.cos(yaw), np.sin(yaw)
    T = np.array([[s, 0, c, x], [-c, 0, s, y], [0, -1, 0, z], [0, 0, 0, 1.0]])
    return T @ se3.exp(np.array([0, 0, roll, 0, 0, 0]))


@pytest.fixture(scope="module")
def tour(look, standpoint):
    """Once round on the spot, then three views from elsewhere, the camera on its side a little."""
    x, y = standpoint
    yaws = 2 * np.pi / N_ROUND * np.arange(N_ROUND)
    poses = [upright(x, y, 1.3, yaw, 0.0) for yaw in yaws]
    poses += [upright(x + 0.15, y - 0.1, 1.2, yaws[k] + 0.1, 0.4) for k in (1, 6, 9)]
    return [look(pose, index) for index, pose in enumerate(poses)], np.array(poses)


@pytest.fixture(scope="module")
def recogniser(tour):
    frames, poses = tour
    recogniser = PlaceRecogniser()
    ids = [recogniser.add(f, se3.inverse(poses[0]) @ T) for f, T in zip(frames, poses, strict=True)]
    assert ids == list(range(len(frames)))
    return recogniser


@pytest.mark.parametrize(("query", "expected"), [(12, 1), (13, 6), (14, 9)])
def test_places_are_recognised_from_aside_and_on_the_side(recogniser, tour, query, expected):
    best, *rest = recogniser.recognise(query, N_ROUND)
    assert best.view_id == expected
    assert best.inlier_ratio > 0.45
    _, poses = tour
    off = se3.inverse(poses[query]) @ poses[expected] @ best.T_match_query
    if query != 13:  # which sees a plain wall, along and about which nothing holds
        assert np.linalg.norm(off[:3, 3]) < 0.05
        assert np.degrees(se3.rotation_angle(off)) < 1.5
    assert all(match.score <= best.score for match in rest)


def test_retrieval_alone_has_the_place_among_the_first(recogniser):
    for query, expected in ((12, 1), (13, 6), (14, 9)):
        shortlist = recogniser.retrieve(query, N_ROUND)
        assert expected in shortlist.view_ids[:3]
        assert shortlist.scores.shape == (N_ROUND,)
        assert (np.diff(shortlist.scores[shortlist.view_ids]) <= 0).all()


def test_retrieval_alone_knows_roughly_from_where(recogniser, tour):
    _, poses = tour
    for query in (12, 14):
        shortlist = recogniser.retrieve(query, N_ROUND)
        off = se3.inverse(poses[query]) @ poses[shortlist.view_ids[0]] @ shortlist.T_match_query[0]
        assert np.linalg.norm(off[:3, 3]) < 0.25
        assert np.degrees(se3.rotation_angle(off)) < 8.0


def test_only_older_views_answer(recogniser):
    assert recogniser.recognise(12, 0) == []
    assert {match.view_id for match in recogniser.recognise(12, 3)} == {0, 1, 2}


def remember(tour, **params):
    frames, poses = tour
    recogniser = PlaceRecogniser(RecogniserParams(**params))
    for frame, pose in zip(frames, poses, strict=True):
        recogniser.add(frame, se3.inverse(poses[0]) @ pose)
    return recogniser


def test_the_number_of_aligned_views_is_limited(tour):
    recogniser = remember(tour, n_aligned=4, search={"n_compared": 6})
    for query in range(1, len(recogniser)):
        assert len(recogniser.recognise(query, query)) == min(query, 4)


def test_without_votes_of_contours_nothing_is_recognised(tour):
    for max_votes, n_found in ((1, 0), (200_000, 2)):
        search = {"n_compared": 2, "max_votes": max_votes}
        recogniser = remember(tour, n_followed=0, search=search)
        assert len(recogniser.recognise(12, N_ROUND)) == n_found


def test_matches_are_followed_to_views_that_nothing_else_leads_to(tour):
    blind = {"search": {"n_compared": 1}, "n_aligned": 6, "n_neighbours": 2}
    recogniser = remember(tour, **blind)
    recogniser.recognise(12, N_ROUND)  # sees what 1 does, and nothing else is compared
    assert len(recogniser.recognise(12, N_ROUND)) > 1
    assert len(remember(tour, **blind, n_followed=0).recognise(12, N_ROUND)) == 1


def test_the_same_frames_give_the_same_answers(tour):
    one, other = (remember(tour) for _ in range(2))
    for query in range(N_ROUND, len(one)):
        answers = (r.recognise(query, N_ROUND) for r in (one, other))
        for a, b in zip(*answers, strict=True):
            assert (a.view_id, a.score) == (b.view_id, b.score)
            np.testing.assert_array_equal(a.T_match_query, b.T_match_query)


def test_an_empty_frame_is_like_nothing(tour):
    (frame, *_), _ = tour
    recogniser = PlaceRecogniser()
    recogniser.add(frame, np.eye(4))
    blind = DepthFrame(1.0, np.zeros_like(frame.depth), frame.intrinsics)
    query = recogniser.add(blind, np.eye(4))
    (match,) = recogniser.recognise(query, 1)
    assert match.inlier_ratio == 0.0
    assert np.isfinite(match.T_match_query).all()
    assert len(recogniser) == 2
    assert recogniser.nbytes > 0


def test_deactivated_views_are_not_found(tour):
    frames, poses = tour
    recogniser = PlaceRecogniser()
    T_odom_camera = se3.inverse(poses[0]) @ poses
    for frame, T in zip(frames[:N_ROUND], T_odom_camera, strict=False):
        recogniser.add(frame, T)
    again = recogniser.add(frames[1], T_odom_camera[1])
    assert recogniser.recognise(again, N_ROUND)[0].view_id == 1
    before = recogniser.nbytes
    recogniser.deactivate()
    asking = recogniser.add(frames[12], T_odom_camera[12])
    assert (again, asking) == (N_ROUND, N_ROUND + 1)
    assert recogniser.nbytes - before < 40_000  # what is searched took its place
    shortlist = recogniser.retrieve(asking, asking)
    assert shortlist.scores[again] == -1.0
    assert again not in shortlist.view_ids
    assert set(shortlist.view_ids) <= set(range(N_ROUND))
    assert recogniser.recognise(asking, asking)[0].view_id == 1
    agreement = recogniser.aligner.agreement(again, np.array([1]), np.eye(4)[None])
    assert agreement.inlier_ratio[0] > 0.99


def test_removed_views_are_not_found_and_matches_are_followed_all_the_same(tour):
    frames, poses = tour
    recogniser = PlaceRecogniser()
    T_odom_camera = se3.inverse(poses[0]) @ poses
    for frame, T in zip(frames, T_odom_camera, strict=False):
        recogniser.add(frame, T)
    before = recogniser.nbytes
    assert recogniser.recognise(12, N_ROUND)[0].view_id == 1
    recogniser.remove([1, 2])
    assert recogniser.nbytes < before
    found = {match.view_id for match in recogniser.recognise(13, N_ROUND)}
    assert 0 in found
    assert not found & {1, 2}
    again = recogniser.add(frames[1], T_odom_camera[1])
    assert again == len(frames)
    agreement = recogniser.aligner.agreement(again, np.array([again]), np.eye(4)[None])
    assert agreement.inlier_ratio[0] > 0.99


def test_gravity_is_estimated_by_the_parameters_of_the_recogniser(tour):
    frames, poses = tour
    narrow = {"first_gates_deg": (1.0,), "gates_deg": (1.0,), "lost_margin": 1.0}
    scores = []
    for params in (RecogniserParams(), RecogniserParams(gravity=narrow)):
        recogniser = PlaceRecogniser(params, gravity_odom=(0.0, 0.96, 0.28))
        for frame, pose in zip(frames[:3], poses, strict=False):
            recogniser.add(frame, se3.inverse(poses[0]) @ pose)
        scores.append(recogniser.retrieve(2, 2).scores)
    assert (scores[0] != scores[1]).all()


def test_a_temporary_query_leaves_nothing_behind(tour):
    frames, _ = tour
    recogniser = remember(tour, search={"n_compared": 1})
    recogniser.recognise(12, N_ROUND)  # which the next view would follow
    before = recogniser.nbytes
    with recogniser.temporary_query(frames[13]) as view_id:
        assert view_id == len(recogniser) - 1 == len(frames)
        alone = recogniser.recognise(view_id, N_ROUND, follow=False)
        assert [match.view_id for match in alone] == [6]
        others = recogniser.recognise(view_id, 9, exclude=[6], follow=False)
        assert 6 not in {match.view_id for match in others}
        same = recogniser.aligner.coverage(view_id, np.array([13]), np.eye(4)[None])
        assert same.inlier_ratio > 0.99
    assert len(recogniser) == len(frames)
    assert recogniser.nbytes == before
    fresh = remember(tour, search={"n_compared": 1})
    fresh.recognise(12, N_ROUND)
    answers = (r.recognise(13, N_ROUND) for r in (recogniser, fresh))
    for a, b in zip(*answers, strict=True):
        assert (a.view_id, a.score) == (b.view_id, b.score)


def test_a_temporary_query_is_removed_after_an_error(tour):
    frames, _ = tour
    recogniser = remember(tour)
    with pytest.raises(RuntimeError), recogniser.temporary_query(frames[0]):
        raise RuntimeError
    assert len(recogniser) == len(frames)
    assert recogniser.recognise(12, N_ROUND)[0].view_id == 1


@pytest.mark.parametrize(("at", "value"), [((0, 3), np.nan), ((3, 0), 0.5), ((0, 0), 3.0)])
def test_a_pose_that_is_none_is_refused(tour, at, value):
    recogniser, T = PlaceRecogniser(), np.eye(4)
    T[at] = value
    with pytest.raises(ValueError, match="found"):
        recogniser.add(tour[0][0], T)
    assert recogniser.add(tour[0][0], np.eye(4)) == 0


@pytest.mark.parametrize(("view_id", "n_views"), [(0, 99), (99, 3), (-1, 3), (5, -3)])
def test_views_that_are_not_there_are_refused(recogniser, view_id, n_views):
    with pytest.raises(ValueError, match=f"found view {view_id} and {n_views} to search"):
        recogniser.recognise(view_id, n_views)
