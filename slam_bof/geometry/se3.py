"""Rigid transforms as (4, 4) matrices: inverse, exp, log, interpolation, alignment.

Tangent vectors are (6,) with the rotation first, the convention of GTSAM. Functions broadcast
over leading axes: (..., 4, 4) in, (..., 4, 4) out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from slam_bof.types import Array, Pose

__all__ = [
    "adjoint",
    "align",
    "check_rigid",
    "checked_pose",
    "exchange_blocks",
    "exp",
    "from_quaternion",
    "interpolate",
    "inverse",
    "log",
    "nearest_pose",
    "nearest_rotation",
    "pose",
    "rotation_angle",
    "to_quaternion",
    "transform",
]


TOLERANCE = 1e-2
"""Largest deviation of ``R.T @ R`` from the identity in a transform given by the user. It permits
numbers with few digits."""
LAST_ROW: Array = np.array([0.0, 0.0, 0.0, 1.0])
LAST_ROW_TOLERANCE = 1e-6
"""Largest deviation of the last row from this."""
EYE: Array = np.eye(3)
SMALL_RAD = 0.03
"""Angles below which a series is more precise."""
MAX_POSITION_M = 1e8
"""Largest coordinate of a position given by the user; geocentric ones have 6.4e6 m."""


def check_rigid(T: Array) -> None:
    """Check a transform (4, 4), or its upper (3, 4), given by the user.

    >>> check_rigid(np.diag([2.0, 2.0, 2.0, 1.0]))
    Traceback (most recent call last):
    ValueError: found a matrix that is no rotation (determinant 8, R'R off by 3), \
expected an orthonormal one of determinant 1

    Raises
    ------
    ValueError
        If it has another shape, is not finite, or is not a rotation and a translation.
    """
    if T.shape not in ((4, 4), (3, 4)):
        raise ValueError(f"found an array {T.shape}, expected a (4, 4) transform")
    if not np.isfinite(T).all():
        raise ValueError("found NaN or infinity, expected 12 finite numbers")
    if (farthest_m := float(np.abs(T[:3, 3]).max())) > MAX_POSITION_M:
        raise ValueError(f"found a position at {farthest_m:g} m, expected metres")
    R = T[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    determinant = float(np.linalg.det(R))
    if off > TOLERANCE or determinant < 0.0:
        raise ValueError(
            f"found a matrix that is no rotation (determinant {determinant:.6g}, "
            f"R'R off by {off:.3g}), expected an orthonormal one of determinant 1"
        )
    if len(T) == 4 and np.abs(T[3] - LAST_ROW).max() > LAST_ROW_TOLERANCE:
        last_row = " ".join(f"{number:g}" for number in T[3])
        raise ValueError(f"found a last row {last_row}, expected 0 0 0 1")


def checked_pose(T: ArrayLike) -> Pose:
    """Return a copy of a pose (4, 4) given by the user, as float64 with an exact last row.

    Raises
    ------
    ValueError
        If it is no array of numbers, or in the cases of ``check_rigid``.
    """
    found = np.asarray(T)
    if found.dtype.kind not in "fiu":
        raise ValueError(f"found an array of {found.dtype}, expected numbers (4, 4)")
    if found.shape == (3, 4):
        raise ValueError("found a (3, 4) matrix, expected (4, 4): its last row is 0 0 0 1")
    checked = np.array(found, dtype=np.float64)
    check_rigid(checked)
    checked[3] = LAST_ROW
    return checked


def pose(R: ArrayLike, t: ArrayLike) -> Pose:
    """Compose a (4, 4) transform from a (3, 3) rotation and a (3,) translation."""
    T = np.eye(4)
    T[:3, :3] = R
    T[:3, 3] = t
    return T


def inverse(T: Pose) -> Pose:
    """Invert transforms (..., 4, 4).

    >>> T = exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
    >>> np.allclose(inverse(T) @ T, np.eye(4))
    True
    """
    T = np.asarray(T, dtype=np.float64)
    R_t = np.swapaxes(T[..., :3, :3], -1, -2)
    inverted = np.zeros_like(T)
    inverted[..., :3, :3] = R_t
    inverted[..., :3, 3] = -(R_t @ T[..., :3, 3:])[..., 0]
    inverted[..., 3, 3] = 1.0
    return inverted


def exp(tangent: Array) -> Pose:
    """Map tangent vectors (..., 6), rotation first, to transforms (..., 4, 4).

    With K the cross product matrix of the rotation and a its angle, the rotation is
    I + (sin a / a) K + ((1 - cos a) / a^2) K^2, and the translation is multiplied with
    I + ((1 - cos a) / a^2) K + ((a - sin a) / a^3) K^2.
    """
    tangent = np.asarray(tangent, dtype=np.float64)
    K, angle = _cross_matrix(tangent)
    square = K @ K
    sine = np.sinc(angle / np.pi)
    cosine = 0.5 * np.square(np.sinc(angle / (2.0 * np.pi)))
    angle_2 = np.square(angle)
    remainder = np.where(
        angle < SMALL_RAD,
        1.0 / 6.0 - angle_2 * (1.0 / 120.0 - angle_2 / 5040.0),
        (1.0 - sine) / np.where(angle < SMALL_RAD, 1.0, angle_2),
    )
    T = np.zeros((*K.shape[:-2], 4, 4))
    T[..., :3, :3] = EYE + sine * K + cosine * square
    T[..., :3, 3:] = (EYE + cosine * K + remainder * square) @ tangent[..., 3:, None]
    T[..., 3, 3] = 1.0
    return T


def log(T: Pose) -> Array:
    """Map transforms (..., 4, 4) to tangent vectors (..., 6), rotation first; undoes ``exp``."""
    T = np.asarray(T, dtype=np.float64)
    tangent = np.empty((*T.shape[:-2], 6))
    R = T[..., :3, :3].reshape(-1, 3, 3)
    rotations = Rotation.from_matrix(R, assume_valid=True).as_rotvec()
    tangent[..., :3] = rotations.reshape((*tangent.shape[:-1], 3))
    K, angle = _cross_matrix(tangent)
    # (1 - a / 2 cot(a / 2)) / a^2
    angle_2 = np.square(angle)
    half = np.where(angle < SMALL_RAD, 1.0, 0.5 * angle)
    remainder = np.where(
        angle < SMALL_RAD,
        1.0 / 12.0 + angle_2 * (1.0 / 720.0 + angle_2 / 30240.0),
        0.25 * (1.0 - half / np.tan(half)) / np.square(half),
    )
    inverse_translation = EYE - 0.5 * K + remainder * (K @ K)
    tangent[..., 3:] = (inverse_translation @ T[..., :3, 3:])[..., 0]
    return tangent


def _cross_matrix(tangent: Array) -> tuple[Array, Array]:
    """Return matrices (..., 3, 3) of the cross product with vectors, and lengths (..., 1, 1)."""
    x, y, z = tangent[..., 0], tangent[..., 1], tangent[..., 2]
    K = np.zeros((*tangent.shape[:-1], 3, 3))
    K[..., 2, 1], K[..., 0, 2], K[..., 1, 0] = x, y, z
    K[..., 1, 2], K[..., 2, 0], K[..., 0, 1] = -x, -y, -z
    return K, np.sqrt(x * x + y * y + z * z)[..., None, None]


def transform(T_a_b: Pose, points_b: Array) -> Array:
    """Transform points (N, 3) to frame a: ``p_a = T_a_b @ p_b``."""
    return points_b @ T_a_b[:3, :3].T + T_a_b[:3, 3]


def adjoint(T_a_b: Array) -> Array:
    """Return the matrix (..., 6, 6) that makes a small motion of frame b one of frame a.

    Tangents have the rotation first; ``T_a_b`` is (..., 4, 4).
    """
    R, t = T_a_b[..., :3, :3], T_a_b[..., :3, 3]
    made = np.zeros((*T_a_b.shape[:-2], 6, 6))
    made[..., :3, :3] = made[..., 3:, 3:] = R
    made[..., 3:, :3] = _cross_matrix(t)[0] @ R
    return made


def exchange_blocks(matrix: Array) -> Array:
    """Return a matrix (..., 6, 6) of tangents with rotation and translation exchanged.

    >>> exchange_blocks(np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])).diagonal()
    array([4., 5., 6., 1., 2., 3.])
    """
    return np.roll(matrix, 3, axis=(-2, -1))


def rotation_angle(T: Pose) -> Array:
    """Return the rotation angle, in [0, pi] radians, of (..., 4, 4) or (..., 3, 3)."""
    T = np.asarray(T, dtype=np.float64)
    R = T[..., :3, :3]
    # arctan2 of sine and cosine is precise at 0 and at pi, where arccos is not.
    axis = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        axis=-1,
    )
    trace = np.trace(R, axis1=-2, axis2=-1)
    return np.asarray(np.arctan2(np.linalg.norm(axis, axis=-1), trace - 1.0))


def interpolate(T_a: Pose, T_b: Pose, fraction: float | Array) -> Pose:
    """Return the pose at ``fraction`` in [0, 1] on the geodesic between two poses (4, 4).

    For many pairs at once, pass (N, 4, 4) poses and (N, 1) fractions.
    """
    step = exp(fraction * log(inverse(T_a) @ T_b))
    return np.asarray(T_a @ step)


def nearest_rotation(R: ArrayLike) -> Array:
    """Return the rotations nearest to matrices (..., 3, 3), by SVD."""
    U, _, Vt = np.linalg.svd(np.asarray(R, dtype=np.float64))
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def nearest_pose(T: ArrayLike) -> Pose:
    """Return transforms (..., 4, 4) with their rotations made orthonormal."""
    # The order of memory decides the last bits of products.
    T = np.array(T, dtype=np.float64, order="C")
    T[..., :3, :3] = nearest_rotation(T[..., :3, :3])
    T[..., 3, :] = LAST_ROW
    return T


def align(points_reference: Array, points_estimate: Array) -> Pose:
    """Return the rigid ``T_reference_estimate`` that aligns paired points best (Umeyama 1991).

    Parameters
    ----------
    points_reference, points_estimate
        (N, 3) paired points, N at least 1. If they do not determine the rotation (N < 3, or points
        on a line), one of the best rotations is returned.

    Returns
    -------
    Pose
        (4, 4) transform without scale.
    """
    if points_reference.shape != points_estimate.shape or points_reference.ndim != 2:
        raise ValueError(
            f"points must be paired (N, 3), got {points_reference.shape} "
            f"and {points_estimate.shape}"
        )
    mean_reference = points_reference.mean(axis=0)
    mean_estimate = points_estimate.mean(axis=0)
    covariance = (points_reference - mean_reference).T @ (points_estimate - mean_estimate)
    R = nearest_rotation(covariance)
    return pose(R, mean_reference - R @ mean_estimate)


def from_quaternion(quaternion_xyzw: ArrayLike, t: ArrayLike) -> Pose:
    """Compose (..., 4, 4) from quaternions (..., 4), x y z w, and translations (..., 3)."""
    quaternion = np.asarray(quaternion_xyzw, dtype=np.float64)
    T = np.zeros((*quaternion.shape[:-1], 4, 4))
    T[..., :3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[..., :3, 3] = t
    T[..., 3, 3] = 1.0
    return T


def to_quaternion(T: Pose) -> Array:
    """Return unit quaternions (..., 4), x y z w with w >= 0, of transforms (..., 4, 4)."""
    return np.asarray(Rotation.from_matrix(T[..., :3, :3]).as_quat(canonical=True))
