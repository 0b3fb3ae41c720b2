"""Resuming the odometry of an interrupted run: from a saved state, or by running it again."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.ports import Dataset, Odometry, ResumableOdometry
from slam_bof.types import DepthFrame, FramePose, OdometryState, Pose

__all__ = ["check_odometry", "check_stamp", "restore_odometry", "state_of"]

MAX_DIFFERENCE = 1e-6
"""Largest difference of the odometry, in any entry of the pose, when a run is resumed."""

logger = logging.getLogger(__name__)


def state_of(odometry: Odometry, indices: Sequence[int]) -> OdometryState | None:
    """Return the state of an odometry to be saved, None if it has none that can be saved.

    ``indices`` are those of the frames of the data set that it has processed before the newest
    one, without those that could not be used.
    """
    if not isinstance(odometry, ResumableOdometry):
        return None
    n_read = indices[-1] + 1 if indices else 0
    skipped = np.setdiff1d(np.arange(n_read), indices)
    return OdometryState(len(indices), skipped, odometry.state())


def restore_odometry(
    odometry: Odometry,
    saved: OdometryState | None,
    dataset: Dataset,
    restored: Sequence[FramePose],
) -> list[int]:
    """Restore a saved state; return the indices of the frames that need not be processed again.

    None need not if there is no state, or it is not one of this odometry and these ``restored``
    frames.

    Raises
    ------
    DatasetError
        If the last of these frames is not in the data set.
    """
    if saved is None or not isinstance(odometry, ResumableOdometry):
        return []
    n = saved.frame_index + 1
    if n > len(restored):
        return []
    indices = np.setdiff1d(np.arange(n + len(saved.skipped)), saved.skipped)
    if len(indices) != n or indices[-1] >= len(dataset):
        return []
    try:
        odometry.restore(saved.arrays)
    except ValueError as error:
        odometry.reset()
        logger.warning("the saved state of the odometry cannot be used: %s", error)
        return []
    last = int(indices[-1])
    check_stamp(dataset, last, dataset.frame(last), restored[n - 1])
    return [int(index) for index in indices]


def check_stamp(dataset: Dataset, index: int, frame: DepthFrame, before: FramePose) -> None:
    """Check that a frame is the same as in the interrupted run."""
    if frame.stamp_s != before.stamp_s:
        raise DatasetError(
            f"{dataset.sequence}: frame {index}: found stamp {frame.stamp_s} s, expected "
            f"{before.stamp_s} s as in the interrupted run: is this the same sequence?"
        )


def check_odometry(dataset: Dataset, index: int, T_odom_camera: Pose, before: FramePose) -> None:
    """Check that the odometry of a frame is the same as in the interrupted run."""
    difference = float(np.abs(se3.inverse(before.T_odom_raw) @ T_odom_camera - np.eye(4)).max())
    if difference > MAX_DIFFERENCE:
        raise DatasetError(
            f"{dataset.sequence}: frame {index}: found an odometry pose that differs by "
            f"{difference:.2g} (m, rad) from that of the interrupted run, expected the same: is "
            "this the same sequence, and is the odometry deterministic?"
        )
