import numpy as np
import pytest

from slam_bof.geometry import se3

RNG = np.random.default_rng(0)


def tangents(angle_rad: float, n: int = 20) -> np.ndarray:
    axes = RNG.normal(size=(n, 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return np.hstack([angle_rad * axes, RNG.normal(size=(n, 3))])


HARD_ANGLES = [0.0, 1e-9, 1e-6, 1e-3, 1.0, np.pi - 1e-3, np.pi - 1e-6]


@pytest.mark.parametrize("angle_rad", HARD_ANGLES)
def test_log_undoes_exp(angle_rad: float) -> None:
    x = tangents(angle_rad)
    np.testing.assert_allclose(se3.log(se3.exp(x)), x, rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle_rad", [*HARD_ANGLES, np.pi])
def test_exp_gives_rotations_and_log_gives_them_back(angle_rad: float) -> None:
    T = se3.exp(tangents(angle_rad))
    R = T[:, :3, :3]
    np.testing.assert_allclose(
        R @ np.swapaxes(R, -1, -2), np.tile(np.eye(3), (20, 1, 1)), atol=1e-14
    )
    np.testing.assert_allclose(np.linalg.det(R), 1.0)
    np.testing.assert_array_equal(T[:, 3], np.tile([0, 0, 0, 1], (20, 1)))
    np.testing.assert_allclose(se3.exp(se3.log(T)), T, rtol=0, atol=1e-9)


@pytest.mark.parametrize("angle_rad", [*HARD_ANGLES, np.pi])
def test_rotation_angle_keeps_its_precision_at_both_ends(angle_rad: float) -> None:
    T = se3.exp(tangents(angle_rad))
    np.testing.assert_allclose(se3.rotation_angle(T), angle_rad, rtol=0, atol=1e-14)
    np.testing.assert_allclose(se3.rotation_angle(T[:, :3, :3]), angle_rad, rtol=0, atol=1e-14)


def test_tangents_have_rotation_first() -> None:
    T = se3.exp(np.array([0.0, 0.0, np.pi / 2, 0.0, 0.0, 3.0]))
    np.testing.assert_allclose(T[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_allclose(T[:3, 3], [0, 0, 3])


@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_inverse_exp_and_log_broadcast_over_leading_axes(shape: tuple[int, ...]) -> None:
    x = RNG.normal(size=(*shape, 6))
    T = se3.exp(x)
    assert T.shape == (*shape, 4, 4)
    assert se3.log(T).shape == (*shape, 6)
    identity = np.broadcast_to(np.eye(4), T.shape)
    np.testing.assert_allclose(se3.inverse(T) @ T, identity, atol=1e-14)
    np.testing.assert_allclose(se3.inverse(se3.inverse(T)), T, atol=1e-14)


def test_inverse_of_a_product_is_the_product_of_inverses_reversed() -> None:
    A, B = se3.exp(RNG.normal(size=(2, 6)))
    expected = se3.inverse(B) @ se3.inverse(A)
    np.testing.assert_allclose(se3.inverse(A @ B), expected, atol=1e-14)


def test_pose_composes_and_transform_applies_it() -> None:
    T = se3.exp(RNG.normal(size=6))
    np.testing.assert_array_equal(se3.pose(T[:3, :3], T[:3, 3]), T)
    points = RNG.normal(size=(7, 3))
    homogeneous = np.hstack([points, np.ones((7, 1))]) @ T.T
    np.testing.assert_allclose(se3.transform(T, points), homogeneous[:, :3], atol=1e-14)
    assert se3.transform(T, np.empty((0, 3))).shape == (0, 3)


def test_interpolate_meets_both_ends_and_halves_the_way() -> None:
    A, B = se3.exp(RNG.normal(size=(2, 6)))
    np.testing.assert_allclose(se3.interpolate(A, B, 0.0), A, atol=1e-13)
    np.testing.assert_allclose(se3.interpolate(A, B, 1.0), B, atol=1e-13)
    half = se3.interpolate(A, B, 0.5)
    np.testing.assert_allclose(se3.inverse(A) @ half, se3.inverse(half) @ B, atol=1e-13)


def test_interpolate_takes_many_pairs() -> None:
    A, B = se3.exp(RNG.normal(size=(2, 4, 6)))
    fractions = np.array([0.0, 0.3, 0.7, 1.0])
    many = se3.interpolate(A, B, fractions[:, None])
    for i, fraction in enumerate(fractions):
        np.testing.assert_allclose(many[i], se3.interpolate(A[i], B[i], fraction), atol=1e-14)


def test_nearest_rotation_of_a_spoiled_rotation() -> None:
    R = se3.exp(tangents(2.0, 1))[0, :3, :3]
    repaired = se3.nearest_rotation(R + 1e-4 * RNG.normal(size=(3, 3)))
    np.testing.assert_allclose(repaired @ repaired.T, np.eye(3), atol=1e-14)
    assert se3.rotation_angle(R.T @ repaired) < 1e-3
    np.testing.assert_allclose(se3.nearest_rotation(R), R, atol=1e-14)


def test_nearest_poses_are_those_of_each_alone() -> None:
    T = se3.exp(tangents(2.0, 5))
    spoiled = T + 1e-4 * RNG.normal(size=T.shape)
    nearest = se3.nearest_pose(spoiled)
    for found, one in zip(nearest, spoiled, strict=True):
        se3.check_rigid(found)
        np.testing.assert_array_equal(found, se3.nearest_pose(one))
        np.testing.assert_array_equal(found[:3, 3], one[:3, 3])
    np.testing.assert_allclose(nearest, T, atol=1e-3)


def test_nearest_rotation_never_mirrors() -> None:
    mirror = np.diag([1.0, 1.0, -1.0])
    assert np.linalg.det(se3.nearest_rotation(mirror)) == pytest.approx(1.0)


def test_align_recovers_a_transform() -> None:
    T = se3.exp(tangents(3.0, 1))[0]
    points = RNG.normal(size=(30, 3))
    np.testing.assert_allclose(se3.align(se3.transform(T, points), points), T, atol=1e-13)


def test_align_is_the_best_rigid_fit_of_noisy_points() -> None:
    points = RNG.normal(size=(50, 3))
    reference = se3.transform(se3.exp(RNG.normal(size=6)), points)
    reference += 0.05 * RNG.normal(size=(50, 3))
    best = se3.align(reference, points)

    def squared_error(T: np.ndarray) -> float:
        return float(np.sum((reference - se3.transform(T, points)) ** 2))

    for step in se3.exp(1e-3 * RNG.normal(size=(20, 6))):
        assert squared_error(best) < squared_error(best @ step)


@pytest.mark.parametrize(
    "points",
    [
        np.array([[1.0, 2.0, 3.0]]),
        np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 3.0]]),
        np.linspace(0.0, 1.0, 9)[:, None] * [1.0, -2.0, 0.5],
        np.zeros((5, 3)),
        np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]]),
    ],
    ids=["one point", "two points", "a line", "one place", "a plane"],
)
def test_align_of_points_without_spread_is_a_rotation_that_fits(points: np.ndarray) -> None:
    T = se3.exp(tangents(2.0, 1))[0]
    found = se3.align(se3.transform(T, points), points)
    np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-13)
    assert np.linalg.det(found[:3, :3]) == pytest.approx(1.0)
    fitted = se3.transform(found, points)
    np.testing.assert_allclose(fitted, se3.transform(T, points), atol=1e-13)


def test_align_wants_pairs() -> None:
    with pytest.raises(ValueError, match=r"paired \(N, 3\), got \(2, 3\) and \(3, 3\)"):
        se3.align(np.zeros((2, 3)), np.zeros((3, 3)))


@pytest.mark.parametrize("angle_rad", [*HARD_ANGLES, np.pi])
def test_quaternions_round_trip(angle_rad: float) -> None:
    T = se3.exp(tangents(angle_rad))
    quaternions = se3.to_quaternion(T)
    np.testing.assert_allclose(np.linalg.norm(quaternions, axis=1), 1.0)
    assert (quaternions[:, 3] >= 0.0).all()
    np.testing.assert_allclose(se3.from_quaternion(quaternions, T[:, :3, 3]), T, atol=1e-14)


def test_quaternions_are_x_y_z_w_and_need_no_unit_norm() -> None:
    T = se3.from_quaternion([0.0, 0.0, 2.0, 2.0], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(T[:3, :3] @ [1, 0, 0], [0, 1, 0], atol=1e-15)
    np.testing.assert_array_equal(T[:3, 3], [1, 2, 3])
    np.testing.assert_allclose(se3.to_quaternion(T), [0, 0, 0.5**0.5, 0.5**0.5])
