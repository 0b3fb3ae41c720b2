import numpy as np
import pytest

from slam_bof.bof import (
    Constellation,
    ConstellationIndex,
    ConstellationParams,
    MatchingParams,
    describe_constellation,
    match_constellations,
)
from slam_bof.bof.constellation import place_bofs
from slam_bof.bof.constellation_correspondences import find_correspondences
from slam_bof.bof.levelled_slices import SliceParams
from slam_bof.geometry import GravityTracker, make_view, se3
from slam_bof.testing.scenery import blind, example_frames

PARAMS = ConstellationParams()


def described(frame):
    gravity = GravityTracker().update(make_view(frame).known_normals(), np.eye(4))
    return describe_constellation(frame, gravity)


@pytest.fixture(scope="module")
def pair():
    """Two of a slow turn in a furnished room, 12 degrees apart."""
    frames, T_first_camera = example_frames()
    T_match_query = se3.inverse(T_first_camera[0]) @ T_first_camera[15]
    return described(frames[15]), described(frames[0]), T_match_query


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
    pairs = find_correspondences(query, other, MatchingParams(), PARAMS.slices.step_m)
    found = np.stack([pairs.yaw, pairs.shift.real, pairs.height, pairs.shift.imag], axis=1)
    off = np.abs(found - motion) < [np.radians(4), 0.1, 0.05, 0.1]
    assert off.all(axis=1).sum() > 20


def test_heights_are_in_metres_whatever_the_step_of_the_slices():
    params = ConstellationParams(slices=SliceParams(n_slices=15, step_m=0.2))
    query, higher = (place_bofs(moved(scene(), 0, 0, y, 0), params) for y in (0.0, 0.4))
    step_m = params.slices.step_m
    ours, theirs = (Constellation(bofs, np.eye(3), step_m) for bofs in (query, higher))
    index = ConstellationIndex(slice_step_m=step_m)
    index.add(higher)
    assert match_constellations(ours, theirs)[0].T_match_query[1, 3] == pytest.approx(0.4, abs=0.05)
    assert index.find(query, 1).motions.height[0] == pytest.approx(0.4, abs=0.05)


def test_the_pose_between_two_views_is_found(pair):
    query, match, T_match_query = pair
    best = match_constellations(query, match)[0]
    error = se3.inverse(T_match_query) @ best.T_match_query
    assert np.linalg.norm(error[:3, 3]) < 0.25
    assert np.degrees(se3.rotation_angle(error)) < 7.0
    assert best.inliers.shape[1] == 2
    assert len(best.inliers) > 5


def test_a_view_matches_itself_best(pair):
    itself = match_constellations(pair[0], pair[0])[0]
    np.testing.assert_allclose(itself.T_match_query, np.eye(4), atol=0.02)
    assert 1.0 >= itself.score > 2 * match_constellations(pair[0], pair[1])[0].score


def test_a_scene_that_repeats_itself_has_several_motions():
    one = moved(scene(3)[: 4 * 6000], 0, 0, 0, -0.4)
    row = np.concatenate([one, moved(one, 0, 0, 0, 1.5)])
    query, other = place_bofs(one, PARAMS), place_bofs(row, PARAMS)
    found = match_constellations(Constellation(query, np.eye(3)), Constellation(other, np.eye(3)))
    z = sorted(h.T_match_query[2, 3] for h in found[:2])
    np.testing.assert_allclose(z, [0.0, 1.5], atol=0.06)


def test_harmonics_keep_radii_within_their_resolution():
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
    empty = described(blind(example_frames(1)[0][0])[which])
    assert len(empty) == 0
    assert match_constellations(empty, pair[0]) == match_constellations(pair[0], empty) == []
