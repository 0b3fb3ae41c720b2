"""Precision and recall of loop closures against ground truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from slam_bof.geometry import se3
from slam_bof.types import Array, EdgeKind, Loop, Trajectory

__all__ = ["loop_errors", "loop_precision", "loop_recall", "revisits", "same_place"]


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
    """Return the share of loops whose pose agrees with ground truth.

    None where there is no ground truth for any loop. Other parameters are those of ``loop_errors``.
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
    """Return which frames revisit the place of which older frames.

    A frame revisits a place if, by ground truth, it is within the given distance and angle of a
    frame at least ``min_age_frames`` older.

    Returns
    -------
    NDArray
        (K, K) bool; rows are the frames that revisit, columns the older ones. False where the
        ground truth is unknown.
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
    """Return which keyframes revisit the place of an older one, (K,); see ``same_place``."""
    return np.asarray(same_place(keyframe_indices, reference).any(axis=1))


def loop_recall(
    loops: Sequence[Loop], keyframe_indices: Sequence[int], reference: Trajectory | None
) -> float | None:
    """Return the share of revisiting keyframes that have a loop; None if no keyframe revisits.

    Covisibility edges do not count. Parameters are those of ``loop_errors``.
    """
    if reference is None:
        return None
    revisiting = revisits(keyframe_indices, reference)
    if not revisiting.any():
        return None
    with_loop = {loop.query_id for loop in loops if loop.kind == EdgeKind.LOOP}
    return float(np.mean([id_ in with_loop for id_ in np.flatnonzero(revisiting)]))
