import numpy as np
import pytest
from verifiers import verify

from slam_bof.geometry import PointParams, is_partial, points_camera, se3
from slam_bof.synthetic import spin
from slam_bof.types import DepthFrame, Intrinsics
from slam_bof_plugins.verifier_open3d import Open3dVerifier

FRAME = DepthFrame(0.0, np.zeros((1, 1), np.uint16), Intrinsics(1, 1, 1.0, 1.0, 0.0, 0.0))
"""Of no matter here: clouds are what is aligned."""
CLOUD = PointParams(stride=4, max_range_m=4.0)


@pytest.fixture(scope="module")
def golden(look, standpoint):
    """Points of two views of one place, of a third the other way, and the true T_match_query."""
    T_world_match = spin(*standpoint, angle_deg=180.0)[0]
    T_match_query = se3.exp(np.array([0.05, 0.2, -0.03, 0.15, -0.05, 0.1]))
    T_match_behind = se3.exp(np.array([0.0, np.pi, 0.0, 0.0, 0.0, 0.0]))
    query, match, behind = (
        points_camera(look(T_world_match @ T, i), CLOUD)
        for i, T in enumerate([T_match_query, np.eye(4), T_match_behind])
    )
    return query, match, behind, T_match_query


@pytest.fixture
def verifier():
    return Open3dVerifier()


def prepare(verifier, points):
    return verifier.prepare(FRAME, points)


def assert_golden(verified, T_match_query):
    error = se3.inverse(T_match_query) @ verified.T_match_query
    assert verified.accepted, verified.reason
    assert verified.reason == ""
    assert np.linalg.norm(error[:3, 3]) < 0.03
    assert np.degrees(se3.rotation_angle(error)) < 1.0


def test_it_recovers_the_golden_pose_from_nothing_whatever_the_seed(verifier, golden):
    query, match, _, T_match_query = golden
    for seed in (0, 1):
        verified = verify(verifier, prepare(verifier, query), prepare(verifier, match), seed=seed)
        assert_golden(verified, T_match_query)


def test_same_input_and_seed_same_bytes(verifier, golden):
    query, match, *_ = golden
    first, second = (
        verify(verifier, prepare(verifier, query), prepare(verifier, match), seed=3)
        for _ in range(2)
    )
    assert first.T_match_query.tobytes() == second.T_match_query.tobytes()
    assert first.information.tobytes() == second.information.tobytes()


def test_views_of_different_things_are_rejected_in_words(verifier, golden):
    query, _, behind, _ = golden
    verified = verify(verifier, prepare(verifier, query), prepare(verifier, behind))
    assert not verified.accepted
    assert "overlap" in verified.reason


@pytest.fixture
def wall():
    x, y = np.meshgrid(np.linspace(-2, 2, 80), np.linspace(-1.5, 1.5, 60))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, 2.0)], axis=1)
    points[:, 2] += 0.002 * np.random.default_rng(0).standard_normal(len(points))
    return points


def test_a_bare_wall_leaves_a_pose_open(verifier, wall):
    """It fits itself wherever one slides along it."""
    prepared = prepare(verifier, wall)
    verified = verify(verifier, prepared, prepared, np.eye(4))
    assert is_partial(verified.information)


def test_information_is_in_the_query_s_axes_rotation_first(verifier, wall):
    """Of a wall ahead one knows its distance and its tilt, seen from a turned camera too."""
    T_match_query = se3.exp(np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 0.0])) @ se3.exp(
        np.array([0.3, 0.0, 0.0, 0.0, 0.0, 0.0])
    )
    query = se3.transform(se3.inverse(T_match_query), wall)
    information = verify(
        verifier, prepare(verifier, query), prepare(verifier, wall), T_match_query
    ).information
    turned = T_match_query[:3, :3].T
    in_wall_axes = [
        turned.T @ block @ turned for block in (information[:3, :3], information[3:, 3:])
    ]
    rotation, translation = (np.diag(block) / np.trace(block) for block in in_wall_axes)
    np.testing.assert_allclose(translation, [0.0, 0.0, 1.0], atol=0.01)
    assert rotation[2] < 0.01
    assert rotation[:2].min() > 0.2


@pytest.mark.parametrize("n_points", [0, 2])
def test_too_few_points_are_an_answer(verifier, golden, n_points):
    few = prepare(verifier, np.ones((n_points, 3)))
    verified = verify(verifier, few, prepare(verifier, golden[1]))
    assert (verified.accepted, verified.reason) == (False, "too few points")
