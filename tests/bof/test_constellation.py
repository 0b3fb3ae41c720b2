import numpy as np
import pytest

from slam_bof.bof import (
    Constellation,
    ConstellationParams,
    MatchingParams,
    describe_constellation,
    match_constellations,
)
from slam_bof.bof.constellation import place_bofs
from slam_bof.bof.constellation_matching import find_correspondences
from slam_bof.geometry import GravityTracker, make_view, se3
from slam_bof.testing.scenery import blind, pair_of_views

PARAMS = ConstellationParams()


def described(frame):
    gravity = GravityTracker().update(make_view(frame).known_normals(), np.eye(4))
    return describe_constellation(frame, gravity)


@pytest.fixture(scope="module")
def pair():
    query, match, behind, T_match_query = pair_of_views()
    return described(query), described(match), described(behind), T_match_query


def moved(points_level, yaw, x, y, z):
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    return (points_level @ R.T + [x, y, z]).astype(np.float32)


def scene(seed=0):
    """Points (N, 3) of upright boxes, each turned its own way."""
    random = np.random.default_rng(seed)
    boxes = []
    for k in range(8):
        box = random.uniform(-0.5, 0.5, (6000, 3)) * random.uniform(0.4, 1.2, 3)
        place = [-1.2 + 0.8 * (k % 4), random.uniform(-0.5, 1.0), 1.6 + 1.2 * (k // 4)]
        boxes.append(moved(box, random.uniform(-1, 1), *place))
    return np.concatenate(boxes)


def test_a_motion_is_recovered_from_one_correspondence():
    motion = (np.radians(20.0), 0.3, 0.1, -0.2)
    query = place_bofs(scene(), PARAMS)
    other = place_bofs(moved(scene(), *motion), PARAMS)
    pairs = find_correspondences(query, other, MatchingParams())
    found = np.stack([pairs.yaw, pairs.shift.real, pairs.height, pairs.shift.imag], axis=1)
    off = np.abs(found - motion) < [np.radians(4), 0.1, 0.05, 0.1]
    assert off.all(axis=1).sum() > 20


def test_the_pose_between_real_views_is_found(pair):
    query, match, _, T_match_query = pair
    best = match_constellations(query, match)[0]
    error = se3.inverse(T_match_query) @ best.T_match_query
    assert np.linalg.norm(error[:3, 3]) < 0.15
    assert np.degrees(se3.rotation_angle(error)) < 4.0
    assert len(np.unique(best.inliers[:, 0])) == len(best.inliers) > 5


def test_another_view_scores_less(pair):
    query, match, behind, _ = pair
    right, wrong = match_constellations(query, match)[0], match_constellations(query, behind)
    assert right.score > 2 * max((h.score for h in wrong), default=0.0)


def test_a_view_matches_itself_in_full(pair):
    best = match_constellations(pair[0], pair[0])[0]
    np.testing.assert_allclose(best.T_match_query, np.eye(4), atol=0.02)
    assert 0.9 < best.score < 1.01


def test_a_scene_that_repeats_itself_has_several_motions():
    one = scene(3)[: 4 * 6000]
    row = np.concatenate([one, moved(one, 0, 0, 0, 1.5)])
    query, other = place_bofs(row, PARAMS), place_bofs(moved(row, 0, 0, 0, 0.4), PARAMS)
    found = match_constellations(Constellation(query, np.eye(3)), Constellation(other, np.eye(3)))
    z = [h.T_match_query[2, 3] for h in found]
    assert z[0] == pytest.approx(0.4, abs=0.05)
    assert any(abs(abs(other - 0.4) - 1.5) < 0.1 for other in z[1:])


def test_radii_are_kept_as_far_as_harmonics_tell():
    bofs = place_bofs(scene(1), PARAMS)
    radii = bofs.radii()
    assert radii.shape == (len(bofs.slices), 180)
    np.testing.assert_allclose(radii.max(axis=1), np.exp(bofs.log_radii), rtol=0.2)


def test_the_longest_contours_are_kept():
    few = place_bofs(scene(), ConstellationParams(max_contours=5))
    many = place_bofs(scene(), PARAMS)
    assert len(few.slices) == 5
    np.testing.assert_array_equal(few.lengths_m, many.lengths_m[:5])
    assert (np.diff(many.lengths_m) <= 0).all()


@pytest.mark.parametrize("which", [0, 1])
def test_without_depth_there_is_nothing(which, pair):
    empty = described(blind(pair_of_views()[0])[which])
    assert len(empty) == 0
    assert match_constellations(empty, pair[0]) == match_constellations(pair[0], empty) == []
