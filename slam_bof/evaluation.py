"""How good a run was: trajectory errors, loops, scene labels, retrieval.

Trajectories are compared with their ground truth by time stamp, and only where the ground
truth is known (not NaN). ATE and RPE are those of evo: ``evo_ape tum REF EST -a`` and
``evo_rpe tum REF EST --delta 30 --all_pairs``.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from slam_bof import se3
from slam_bof.types import Array, Loop, Pose, Trajectory

__all__ = [
    "ErrorStats",
    "PrecisionRecall",
    "align_trajectory",
    "associate",
    "ate",
    "confusion",
    "loop_errors",
    "loop_precision",
    "loop_recall",
    "precision_recall",
    "recall_at_k",
    "revisits",
    "rpe",
    "same_place",
    "scene_accuracy",
]

MAX_DIFFERENCE_S = 0.01
MIN_POSES = 3
"""With fewer, an alignment leaves no error to measure."""

Indices = NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class ErrorStats:
    """Translation errors in metres over ``n`` poses."""

    rmse_m: float
    mean_m: float
    median_m: float
    max_m: float
    n: int


@dataclass(frozen=True, slots=True, eq=False)
class PrecisionRecall:
    """A precision-recall curve as scikit-learn has it: (T + 1,) shares, (T,) thresholds."""

    precision: Array
    recall: Array
    thresholds: Array
    average_precision: float


def associate(
    estimate: Trajectory, reference: Trajectory, max_difference_s: float = MAX_DIFFERENCE_S
) -> tuple[Indices, Indices]:
    """Pair the poses of two trajectories by time, as evo does.

    Each pose of the shorter trajectory gets the one nearest in time of the longer; reference
    poses that are NaN do not take part.

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
        at_known = _nearest(estimate.stamps_s, reference_s)
    else:
        at_known = np.arange(len(known))
        at_estimate = _nearest(reference_s, estimate.stamps_s)
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

    The translation of ``(Q_a^-1 Q_b)^-1 (P_a^-1 P_b)`` over all pairs of associated poses that
    many apart; None where there is no such pair.
    """
    i, j = associate(estimate, reference, max_difference_s)
    if len(i) <= n_frames:
        return None
    P, Q = estimate.poses[i], reference.poses[j]
    T_estimate = se3.inverse(P[:-n_frames]) @ P[n_frames:]
    T_reference = se3.inverse(Q[:-n_frames]) @ Q[n_frames:]
    errors = se3.inverse(T_reference) @ T_estimate
    return float(np.sqrt(np.mean(np.sum(errors[:, :3, 3] ** 2, axis=1))))


def loop_errors(
    loops: Sequence[Loop], keyframe_indices: Sequence[int], reference: Trajectory
) -> Array:
    """Compare each loop's ``T_match_query`` with ground truth.

    Parameters
    ----------
    loops, keyframe_indices
        ``keyframe_indices[id]`` is the frame that the keyframe of that id was.
    reference
        ``T_world_camera`` of every frame, in any world frame, NaN where unknown.

    Returns
    -------
    Array
        (L, 2) translation in metres and rotation in radians; NaN where the truth is unknown.
    """
    truth = reference.poses[np.asarray(keyframe_indices, dtype=np.intp)]
    errors = np.full((len(loops), 2), np.nan)
    for row, loop in zip(errors, loops, strict=True):
        T_world_match, T_world_query = truth[[loop.match_id, loop.query_id]]
        if np.isfinite([T_world_match, T_world_query]).all():
            T_match_query = se3.inverse(T_world_match) @ T_world_query
            error = se3.inverse(T_match_query) @ loop.T_match_query
            row[:] = np.linalg.norm(error[:3, 3]), se3.rotation_angle(error)
    return errors


def loop_precision(
    loops: Sequence[Loop],
    keyframe_indices: Sequence[int],
    reference: Trajectory | None,
    *,
    max_translation_m: float = 0.10,
    max_rotation_rad: float = np.radians(5.0),
) -> float | None:
    """Return the share of loops that are right by ground truth; None where none can be told.

    Parameters are those of ``loop_errors``.
    """
    if reference is None:
        return None
    errors = loop_errors(loops, keyframe_indices, reference)
    errors = errors[np.isfinite(errors).all(axis=1)]
    if len(errors) == 0:
        return None
    return float(np.mean((errors <= [max_translation_m, max_rotation_rad]).all(axis=1)))


def same_place(
    frame_indices: Sequence[int],
    reference: Trajectory,
    *,
    min_age_frames: int = 100,
    max_distance_m: float = 0.3,
    max_angle_rad: float = np.radians(25.0),
) -> NDArray[np.bool_]:
    """Tell which frames come back to the place of which others.

    That is, to within the given distance and angle, by ground truth, of a frame at least
    ``min_age_frames`` older.

    Returns
    -------
    NDArray
        (K, K) bool, row: the frame that comes back; column: the older one. False where the
        truth is unknown.
    """
    index = np.asarray(frame_indices, dtype=np.intp)
    truth = reference.poses[index]
    same = np.zeros((len(index), len(index)), dtype=bool)
    for k, T in enumerate(truth):
        # Comparing with NaN is false, so unknown poses are near nothing.
        near = np.linalg.norm(truth[:, :3, 3] - T[:3, 3], axis=1) <= max_distance_m
        turned = se3.rotation_angle(se3.inverse(truth) @ T) <= max_angle_rad
        same[k] = near & turned & (index <= index[k] - min_age_frames)
    return same


def revisits(keyframe_indices: Sequence[int], reference: Trajectory) -> NDArray[np.bool_]:
    """Tell which keyframes come back to the place of an older one, (K,); see ``same_place``."""
    return np.asarray(same_place(keyframe_indices, reference).any(axis=1))


def loop_recall(
    loops: Sequence[Loop], keyframe_indices: Sequence[int], reference: Trajectory | None
) -> float | None:
    """Return the share of the revisiting keyframes that got a loop; None if none revisit.

    Edges between near neighbours in time (``covisibility``) do not count. Parameters are those
    of ``loop_errors``.
    """
    if reference is None:
        return None
    back = revisits(keyframe_indices, reference)
    if not back.any():
        return None
    looped = {loop.query_id for loop in loops if loop.kind == "loop"}
    return float(np.mean([id_ in looped for id_ in np.flatnonzero(back)]))


def scene_accuracy(
    predicted: Sequence[str | None], true: Sequence[str | None] | None
) -> float | None:
    """Return the share of frames with the right label, of those whose true one is known.

    None where there are no labels on either side; a single label missing (None) counts as
    wrong.

    >>> scene_accuracy(["office", "kitchen", None, "office"], ["office", "office", "office", None])
    0.3333333333333333
    """
    if true is None or all(label is None for label in predicted):
        return None
    right = [p == t for p, t in zip(predicted, true, strict=True) if t is not None]
    return float(np.mean(right)) if right else None


def recall_at_k(
    ranked: Sequence[Sequence[Hashable]], relevant: Sequence[Collection[Hashable]], k: int
) -> float | None:
    """Return the share of queries with a relevant answer among the first ``k``.

    Queries to which nothing is relevant do not count; None if that leaves none.

    >>> recall_at_k([[3, 1, 2], [5, 4]], [{1}, {9}], k=2)
    0.5
    """
    asked = [(r, set(wanted)) for r, wanted in zip(ranked, relevant, strict=True) if wanted]
    if not asked:
        return None
    return float(np.mean([not wanted.isdisjoint(answers[:k]) for answers, wanted in asked]))


def precision_recall(scores: ArrayLike, is_true: ArrayLike) -> PrecisionRecall | None:
    """Return the precision-recall curve of scores (N,) against truth (N,).

    None where nothing is true, since recall has then no meaning.
    """
    from sklearn.metrics import average_precision_score, precision_recall_curve

    truth = np.asarray(is_true, dtype=bool)
    if not truth.any():
        return None
    precision, recall, thresholds = precision_recall_curve(truth, scores)
    average = float(average_precision_score(truth, scores))
    return PrecisionRecall(precision, recall, np.asarray(thresholds, np.float64), average)


def confusion(
    predicted: Sequence[str], true: Sequence[str], classes: Sequence[str]
) -> NDArray[np.int64]:
    """Count (C, C) frames by true class (row) and predicted class (column)."""
    counts = np.zeros((len(classes), len(classes)), dtype=np.int64)
    number = {name: i for i, name in enumerate(classes)}
    for p, t in zip(predicted, true, strict=True):
        counts[number[t], number[p]] += 1
    return counts


def _nearest(stamps_s: Array, among_s: Array) -> Indices:
    """Return the index of the nearest of the sorted ``among_s``; the earlier one in a tie."""
    after = np.searchsorted(among_s, stamps_s).clip(1, max(1, len(among_s) - 1))
    after = np.minimum(after, len(among_s) - 1)
    before = np.maximum(after - 1, 0)
    earlier = stamps_s - among_s[before] <= among_s[after] - stamps_s
    return np.asarray(np.where(earlier, before, after), dtype=np.intp)
