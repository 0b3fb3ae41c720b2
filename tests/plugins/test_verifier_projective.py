import numpy as np
import pytest
from verifiers import verify

from slam_bof.geometry import PointParams, points_camera, se3
from slam_bof.ports import ForgettingVerifier
from slam_bof.synthetic import spin
from slam_bof.types import DepthFrame, Intrinsics
from slam_bof_plugins.verifier_projective import ProjectiveParams, ProjectiveVerifier

CAMERA = Intrinsics(160, 120, 146.25, 146.25, 80.0, 60.0)


@pytest.fixture(scope="module")
def golden(look, standpoint):
    """Two views of one place, a third the other way, and the true T_match_query."""
    T_world_match = spin(*standpoint, angle_deg=180.0)[0]
    T_match_query = se3.exp(np.array([0.05, 0.2, -0.03, 0.15, -0.05, 0.1]))
    T_match_behind = se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))
    poses = (T_match_query, np.eye(4), T_match_behind)
    return *(look(T_world_match @ T, i) for i, T in enumerate(poses)), T_match_query


def prepare(verifier, *frames):
    points = PointParams(stride=4)
    return [verifier.prepare(frame, points_camera(frame, points)) for frame in frames]


def assert_golden(verified, T_match_query):
    error = se3.inverse(T_match_query) @ verified.T_match_query
    assert verified.accepted, verified.reason
    assert np.linalg.norm(error[:3, 3]) < 0.02
    assert np.degrees(se3.rotation_angle(error)) < 0.6
    assert verified.rmse_m < 0.03
    assert verified.overlap > 0.6


def test_views_of_different_things_are_rejected_in_words(golden):
    query, _, behind, _ = golden
    verifier = ProjectiveVerifier()
    verified = verify(verifier, *prepare(verifier, query, behind))
    assert not verified.accepted
    assert "overlap" in verified.reason or "before what the other sees" in verified.reason


def blocked_wall(n_columns):
    """A wall at 3 m, and the same behind something at 2 m in the first columns."""
    wall = np.full((120, 160), 3.0, np.float32)
    blocked = wall.copy()
    blocked[:, :n_columns] = 2.0
    return (DepthFrame(0.0, depth, CAMERA) for depth in (wall, blocked))


def test_what_blocks_the_view_is_no_loop():
    """Half of the query stands a metre before the wall that the match sees."""
    verifier = ProjectiveVerifier(ProjectiveParams(min_stiffness=0.0))
    match, query = blocked_wall(70)
    verified = verify(verifier, *prepare(verifier, query, match), np.eye(4))
    assert verified.reason == "0.44 of the points stand before what the other sees"


def test_a_query_that_looks_through_what_the_match_sees_is_no_loop():
    """It sees half of what the match sees, and a metre behind the rest."""
    verifier = ProjectiveVerifier(ProjectiveParams(min_stiffness=0.0))
    query, match = blocked_wall(90)
    verified = verify(verifier, *prepare(verifier, query, match), np.eye(4))
    assert verified.overlap > verifier.params.min_overlap
    assert verified.reason == "agreement -0.13 below 0.1"


def corner(T_world_camera, bend=0.0):
    """A wall 0.8 m to the left, a floor, a back wall and a cupboard, in a camera (4, 4).

    By ``bend`` the depth of the left wall is too long, as a share of it, for each metre beyond 2 m.
    """
    v, u = np.mgrid[:120, :160]
    rays = np.stack([(u - CAMERA.cx) / CAMERA.fx, (v - CAMERA.cy) / CAMERA.fy, np.ones(u.shape)])
    rays = np.tensordot(T_world_camera[:3, :3], rays, 1)
    origin = T_world_camera[:3, 3, None, None]

    def plane(axis, value):
        depth_m = (value - origin[axis]) / np.where(rays[axis] == 0.0, 1e-9, rays[axis])
        depth_m = np.where(depth_m > 0.0, depth_m, 100.0)
        return depth_m, *(origin + depth_m * rays)

    left = plane(0, -0.8)[0]
    front, x, y, _ = plane(2, 2.9)
    front = np.where((x > 0.3) & (x < 1.1) & (y > -0.4), front, 100.0)
    side, _, y, z = plane(0, 0.3)
    side = np.where((z > 2.9) & (z < 3.5) & (y > -0.4), side, 100.0)
    depth_m = np.minimum.reduce([left, plane(1, 1.2)[0], plane(2, 4.0)[0], front, side])
    bent = np.where(depth_m == left, 1.0 + bend * (depth_m - 2.0), 1.0)
    return DepthFrame(0.0, (bent * depth_m).astype(np.float32), CAMERA)


@pytest.mark.parametrize(("bend", "most_m"), [(0.0, 0.002), (0.05, 0.02), (0.1, 0.02)])
def test_a_bent_wall_nearby_does_not_outvote_what_is_far(bend, most_m):
    """Where depth is smooth, as that of a phone."""
    T_match_query = se3.exp(np.array([0.0, 0.03, 0.0, 0.05, 0.0, 0.05]))
    verifier = ProjectiveVerifier()
    views = prepare(verifier, corner(T_match_query, bend), corner(np.eye(4)))
    verified = verify(verifier, *views, np.eye(4))
    off = se3.log(se3.inverse(T_match_query) @ verified.T_match_query)
    assert np.linalg.norm(off[3:]) < most_m


def test_a_bare_wall_is_degenerate():
    wall = DepthFrame(0.0, np.full((120, 160), 2.0, np.float32), CAMERA)
    verifier = ProjectiveVerifier()
    verified = verify(verifier, *prepare(verifier, wall, wall), np.eye(4))
    assert not verified.accepted
    assert verified.reason.startswith("degenerate: stiffness 0.0000 below")
    assert np.linalg.matrix_rank(verified.information, tol=1e-3) == 3


def test_a_bare_wall_is_degenerate_however_much_noise_its_normals_have():
    random = np.random.default_rng(0)
    walls = [
        DepthFrame(0.0, (2.0 + 0.01 * random.standard_normal((120, 160))).astype("f4"), CAMERA)
        for _ in range(2)
    ]
    verifier = ProjectiveVerifier()
    query, match = prepare(verifier, *walls)
    (pairs,) = verifier._aligner.surface_pairs(query, np.array([match]), np.eye(4)[None])
    J = np.hstack([np.cross(pairs.points_query, pairs.normals_query), pairs.normals_query])
    assert np.linalg.eigvalsh(J.T @ J / len(J))[0] > 10 * verifier.params.min_stiffness
    assert verify(verifier, query, match, np.eye(4)).reason.startswith("degenerate: stiffness")


def test_information_is_that_of_the_query_s_frame():
    """Before a bare wall a query knows how far that is and how it leans, and nothing else."""
    wall = DepthFrame(0.0, np.full((120, 160), 2.0, np.float32), CAMERA)
    verifier = ProjectiveVerifier()
    turned = se3.exp(np.array([0.0, 0.0, 0.3, 0.0, 0.0, 0.0]))  # about the view: the wall stays
    information = verify(verifier, *prepare(verifier, wall, wall), turned).information
    known = information[5, 5]  # towards the wall
    assert known > 1.0
    np.testing.assert_allclose(information[2:5, 2:5] / known, 0.0, atol=1e-3)
    assert (np.diag(information)[:2] / known > 0.05).all()


def test_blind_frames_are_rejected(golden):
    blind = DepthFrame(0.0, np.zeros_like(golden[0].depth), golden[0].intrinsics)
    verifier = ProjectiveVerifier()
    verified = verify(verifier, *prepare(verifier, blind, golden[1]), np.eye(4))
    assert not verified.accepted
    assert verified.reason == "no correspondences"
    assert np.isfinite(verified.T_match_query).all()


def test_what_was_prepared_can_be_forgotten(golden):
    query, match, behind, T_match_query = golden
    verifier = ProjectiveVerifier()
    assert isinstance(verifier, ForgettingVerifier)
    (kept,) = prepare(verifier, match)
    for _ in range(2):
        (asking,) = prepare(verifier, behind)
        verifier.forget(asking)
    (asking,) = prepare(verifier, query)
    assert asking == 1
    assert_golden(verify(verifier, asking, kept, T_match_query), T_match_query)
    (later,) = prepare(verifier, match)
    verifier.forget(kept)
    assert_golden(verify(verifier, asking, later, T_match_query), T_match_query)
    with pytest.raises(ValueError, match="view 0 is not kept"):
        verifier.forget(kept)
