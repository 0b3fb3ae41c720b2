"""Protocol of place recognition: which frames are queries, and which answers are right.

Every few frames of a sequence are queries, matched against those of them that are older by a
margin. An answer is relevant by one of two truths: *pose*, the camera is back where it was, and
*overlap*, both frames see the same surfaces, which is what a geometric verification needs.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.errors import DatasetError
from slam_bof.evaluation.loop_metrics import same_place
from slam_bof.geometry import back_project, project, se3
from slam_bof.ports import Dataset
from slam_bof.types import Array, DepthFrame, Params, Pose, Trajectory

__all__ = [
    "PlaceQueries",
    "ProtocolParams",
    "allowed_answers",
    "overlap_shares",
    "relevant_answers",
]

logger = logging.getLogger(__name__)


class ProtocolParams(Params):
    """Which frames are queries, which may be answers, and which answers are relevant."""

    every: int = Field(
        5, gt=0, description="Every n-th frame of a sequence is a query and an answer."
    )
    min_age_frames: int = Field(
        101, gt=0, description="Least number of frames that an answer is older than its query."
    )
    max_distance_m: float = Field(
        0.3, gt=0, description="Truth by pose: largest distance between both cameras, in metres."
    )
    max_angle_deg: float = Field(
        25.0, gt=0, description="Truth by pose: largest angle between both cameras, in degrees."
    )
    min_overlap: float = Field(
        0.5,
        gt=0,
        le=1,
        description="Truth by overlap: least share of either frame's points that the other sees.",
    )
    tolerance_m: float = Field(
        0.05,
        ge=0,
        description="Truth by overlap: a point is seen if its depth agrees to within this many "
        "metres plus tolerance_share of its depth.",
    )
    tolerance_share: float = Field(
        0.02, ge=0, description="Truth by overlap: share of the depth added to tolerance_m."
    )
    stride: int = Field(
        4, gt=0, description="Truth by overlap: every n-th pixel of rows and columns is projected."
    )


@dataclass(frozen=True, slots=True, eq=False)
class PlaceQueries:
    """The K queries of a sequence, which are its possible answers as well.

    They are those of every n-th frame whose true pose is known.

    ``indices`` (K,) are their frames, ``allowed`` (K, K) says which answers (columns) may be given
    to which queries (rows), and ``relevant`` has a (K, K) array for each truth, ``pose`` and
    ``overlap``.
    """

    dataset: Dataset
    indices: list[int]
    allowed: NDArray[np.bool_]
    relevant: dict[str, NDArray[np.bool_]]

    @classmethod
    def of(cls, dataset: Dataset, params: ProtocolParams) -> Self:
        """Choose the queries of a sequence, and find the relevant answers by its ground truth.

        Raises
        ------
        DatasetError
            If the sequence has no ground truth, or no query has a true pose.
        """
        name, groundtruth = dataset.sequence, dataset.groundtruth()
        chosen = np.arange(0, len(dataset), params.every)
        if groundtruth is None:
            raise DatasetError(f"{name}: found no ground truth, expected true poses")
        known = np.isfinite(groundtruth.poses[chosen]).all(axis=(1, 2))
        if not known.any():
            raise DatasetError(f"{name}: found no frame with a true pose, expected some")
        if not known.all():
            logger.warning(
                "%s: %d of %d frames have no true pose and are left out",
                name,
                np.count_nonzero(~known),
                known.size,
            )
        indices: list[int] = chosen[known].tolist()
        frames = [dataset.frame(index) for index in indices]
        relevant = relevant_answers(frames, indices, groundtruth, params)
        return cls(dataset, indices, allowed_answers(indices, params), relevant)


def allowed_answers(frame_indices: Sequence[int], params: ProtocolParams) -> NDArray[np.bool_]:
    """Return which frames (columns) are old enough to answer which queries (rows), (K, K)."""
    index = np.asarray(frame_indices)
    return np.asarray(index[None, :] <= index[:, None] - params.min_age_frames)


def relevant_answers(
    frames: Sequence[DepthFrame],
    frame_indices: Sequence[int],
    reference: Trajectory,
    params: ProtocolParams,
) -> dict[str, NDArray[np.bool_]]:
    """Return the relevant answers (columns) to each query (row), (K, K), by each truth.

    ``frame_indices`` (K,) are the indices of ``frames`` in ``reference``. The keys are ``pose`` and
    ``overlap``.
    """
    allowed = allowed_answers(frame_indices, params)
    by_pose = same_place(
        frame_indices,
        reference,
        min_age_frames=params.min_age_frames,
        max_distance_m=params.max_distance_m,
        max_angle_rad=np.radians(params.max_angle_deg),
    )
    shares = overlap_shares(frames, reference.poses[list(frame_indices)], allowed, params)
    return {"pose": by_pose, "overlap": shares >= params.min_overlap}


def overlap_shares(
    frames: Sequence[DepthFrame],
    T_world_cameras: Array,
    pairs: NDArray[np.bool_],
    params: ProtocolParams,
) -> Array:
    """Return the overlap of pairs of frames, (K, K), 0 where ``pairs`` is False.

    The overlap is the smaller of two shares: of the points of either frame that the other sees.
    """
    depths_m = [frame.depth_m() for frame in frames]
    points = [
        back_project(frame.depth_m(params.stride), frame.intrinsics, params.stride)
        for frame in frames
    ]
    shares = np.zeros(pairs.shape)
    for a, b in np.argwhere(pairs):
        T_b_a = se3.inverse(T_world_cameras[b]) @ T_world_cameras[a]
        shares[a, b] = min(
            _seen_share(points[a], T_b_a, frames[b], depths_m[b], params),
            _seen_share(points[b], se3.inverse(T_b_a), frames[a], depths_m[a], params),
        )
    return shares


def _seen_share(
    points_a: Array, T_b_a: Pose, frame_b: DepthFrame, depth_b_m: Array, params: ProtocolParams
) -> float:
    """Return the share of a's points that b sees at their depth."""
    points_b = se3.transform(T_b_a, points_a)
    rows, columns, is_inside = project(points_b, frame_b.intrinsics)
    measured = depth_b_m[rows, columns]
    expected = points_b[is_inside, 2]
    difference = np.abs(measured - expected)
    tolerance = params.tolerance_m + params.tolerance_share * expected
    seen = (measured > 0) & (difference < tolerance)
    return float(seen.sum() / len(points_a)) if len(points_a) else 0.0
