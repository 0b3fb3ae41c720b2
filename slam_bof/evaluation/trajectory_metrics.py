"""Trajectory errors: absolute trajectory error (ATE) and relative pose error (RPE).

Trajectories are compared with ground truth by time stamp, and only where the ground truth is known
(not NaN). ATE and RPE agree with evo: ``evo_ape tum REF EST -a`` and
``evo_rpe tum REF EST --delta 30 --all_pairs``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import nearest_stamps, se3
from slam_bof.types import Array, Pose, Trajectory

__all__ = ["ErrorStats", "align_trajectory", "associate", "ate", "nees", "rpe"]

MAX_DIFFERENCE_S = 0.01
"""Largest difference of the times of two poses that are compared, as by default in evo."""
MIN_POSES = 3
"""Least number of poses; an alignment of fewer leaves no error to measure."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ErrorStats:
    """Translation errors in metres over ``n`` poses."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    n: int


def associate(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = MAX_DIFFERENCE_S
) -> tuple[Indices, Indices]:
    """Associate the poses of two trajectories by time, as evo does.

    Each pose of the shorter trajectory is paired with the pose of the longer that is nearest in
    time. Reference poses that are NaN are ignored.

    Returns
    -------
    tuple of arrays
        (M,) indices into ``estimate`` and (M,) into ``reference``.

    Examples
    --------
    >>> poses = np.tile(np.eye(4), (3, 1, 1))
    >>> estimate = Trajectory(np.array([0.1, 0.2]), poses[:2])
    >>> reference = Trajectory(np.array([0.0, 0.105, 0.3]), poses)
    >>> [indices.tolist() for indices in associate(estimate, reference)]
    [[0], [1]]
    """
    known = np.flatnonzero(np.isfinite(reference.poses).all(axis=(1, 2)))
    if len(estimate) == 0 or len(known) == 0:
        return np.empty(0, np.intp), np.empty(0, np.intp)
    reference_s = reference.stamps_s[known]
    if len(estimate) <= len(known):
        at_estimate = np.arange(len(estimate))
        at_known = nearest_stamps(estimate.stamps_s, reference_s)
    else:
        at_known = np.arange(len(known))
        at_estimate = nearest_stamps(reference_s, estimate.stamps_s)
    apart_s = np.abs(estimate.stamps_s[at_estimate] - reference_s[at_known])
    near = apart_s <= max_difference_s
    return at_estimate[near], known[at_known[near]]


def align_trajectory(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = MAX_DIFFERENCE_S
) -> Pose | None:
    """Find the rigid ``T_reference_estimate`` that fits the positions best (Umeyama).

    None with fewer than 3 pairs of poses.
    """
    i, j = associate(estimate, reference, max_difference_s)
    if len(i) < MIN_POSES:
        return None
    return se3.align(reference.poses[j, :3, 3], estimate.poses[i, :3, 3])


def ate(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = MAX_DIFFERENCE_S
) -> ErrorStats | None:
    """Measure the absolute trajectory error: positions after rigid alignment.

    None with fewer than 3 pairs of poses.
    """
    T_reference_estimate = align_trajectory(estimate, reference, max_difference_s)
    if T_reference_estimate is None:
        return None
    i, j = associate(estimate, reference, max_difference_s)
    aligned = se3.transform(T_reference_estimate, estimate.poses[i, :3, 3])
    errors_m = np.linalg.norm(reference.poses[j, :3, 3] - aligned, axis=1)
    return ErrorStats(
        rmse_m=float(np.sqrt(np.mean(errors_m**2))),
        mean_m=float(errors_m.mean()),
        median_m=float(np.median(errors_m)),
        max_m=float(errors_m.max()),
        n=len(errors_m),
    )


def rpe(
    estimate: Trajectory,
    reference: Trajectory,
    n_frames: int = 30,
    max_difference_s: float = MAX_DIFFERENCE_S,
) -> float | None:
    """Measure the relative pose error: RMSE in metres of the drift over ``n_frames``.

    It is the translation of ``(Q_a^-1 Q_b)^-1 (P_a^-1 P_b)`` over all pairs of associated poses
    that are ``n_frames`` apart; None where there is no such pair.
    """
    i, j = associate(estimate, reference, max_difference_s)
    if len(i) <= n_frames:
        return None
    P, Q = estimate.poses[i], reference.poses[j]
    T_estimate = se3.inverse(P[:-n_frames]) @ P[n_frames:]
    T_reference = se3.inverse(Q[:-n_frames]) @ Q[n_frames:]
    errors = se3.inverse(T_reference) @ T_estimate
    return float(np.sqrt(np.mean(np.sum(errors[:, :3, 3] ** 2, axis=1))))


def nees(T_estimate: Array, T_truth: Array, covariances: Array) -> float | None:
    """Return the mean normalised estimation error squared, divided by six: 1 is consistent.

    Bar-Shalom, Li and Kirubarajan 2001, section 5.4.

    Parameters
    ----------
    T_estimate, T_truth
        (n, 4, 4) poses; those of which one is NaN do not count.
    covariances
        (n, 6, 6) of the tangents of the estimates, rotation first, in rad^2 and m^2.

    Returns
    -------
    float or None
        None without any pose that counts.
    """
    known = np.isfinite(T_estimate).all(axis=(1, 2)) & np.isfinite(T_truth).all(axis=(1, 2))
    if not known.any():
        return None
    T_error = se3.inverse(T_estimate[known]) @ T_truth[known]
    errors = np.array([se3.log(T) for T in T_error])[:, :, None]
    squares = np.swapaxes(errors, 1, 2) @ np.linalg.solve(covariances[known], errors)
    return float(squares.mean() / 6.0)
