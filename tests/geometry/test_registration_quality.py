import numpy as np
import pytest

from slam_bof.geometry import RegistrationQualityParams, SurfacePairs, assess_registration, reject

CORNER = np.repeat(np.eye(3), 4, axis=0)
"""Normals of three walls, each with four points about its middle."""
POINTS = np.concatenate(
    [
        [[2.0, y, z] for y in (-1, 1) for z in (1, 3)],
        [[x, 2.0, z] for x in (-1, 1) for z in (1, 3)],
        [[x, y, 2.0] for x in (-1, 1) for y in (-1, 1)],
    ]
)
POSE = np.diag([-1.0, -1.0, 1.0, 1.0])


def verify(*, overlap=0.7, guessed=True, residual_m=0.01, normals=CORNER, reason_against=""):
    residuals_m = np.full(len(normals), residual_m)
    points = POINTS[: len(normals)]
    return assess_registration(
        RegistrationQualityParams(),
        POSE,
        SurfacePairs(points, normals, normals, residuals_m),
        overlap=overlap,
        guessed=guessed,
        reason_against=reason_against,
    )


def test_a_corner_holds_a_pose():
    verified = verify()
    assert (verified.accepted, verified.reason) == (True, "")
    assert verified.rmse_m == pytest.approx(0.01)
    np.testing.assert_array_equal(verified.T_match_query, POSE)
    # Four points on each of three walls say where they are, along each axis.
    np.testing.assert_allclose(verified.information[3:, 3:], 4.0 * np.eye(3))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"overlap": 0.3}, "overlap 0.30 below 0.35"),
        ({"overlap": 0.5, "guessed": False}, "overlap 0.50 below 0.6"),
        ({"reason_against": "in the way"}, "in the way"),
        ({"overlap": 0.3, "reason_against": "in the way"}, "overlap 0.30 below 0.35"),
        ({"residual_m": 0.06}, "residual 0.060 m above 0.05 m"),
        ({"normals": CORNER[:4]}, "degenerate: stiffness 0.0000 below 0.0005"),
        ({"normals": CORNER[:0]}, "no correspondences"),
    ],
)
def test_what_is_against_a_pair_is_said_in_words(changes, reason):
    verified = verify(**changes)
    assert not verified.accepted
    assert verified.reason.replace("-0.0000", "0.0000") == reason


def test_what_was_not_aligned_holds_nothing():
    verified = reject("too few points", POSE)
    assert (verified.accepted, verified.reason, verified.overlap) == (False, "too few points", 0.0)
    assert not verified.information.any()
