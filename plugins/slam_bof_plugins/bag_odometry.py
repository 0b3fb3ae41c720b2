"""The odometry that a robot left in its bag, as poses of the depth camera."""

from __future__ import annotations

from pathlib import Path

from slam_bof.errors import DatasetError
from slam_bof.types import Trajectory
from slam_bof_plugins.bag_file import BagFile, open_bag
from slam_bof_plugins.bag_poses import find_odometry, poses_recorded
from slam_bof_plugins.bag_topics import find_depth_topic

__all__ = ["read_bag_odometry"]

OPTION = "--set odometry.options"


def read_bag_odometry(
    path: Path,
    *,
    topic: str | None = None,
    camera_frame: str | None = None,
    world_frame: str = "odom",
    max_gap_s: float = 0.25,
) -> Trajectory:
    """Return ``T_world_camera`` at the times of the poses in a bag.

    Without a ``topic``, the only one of nav_msgs/Odometry, else of stamped poses, else tf, of
    which poses are in the ``world_frame``. Without a ``camera_frame``, that of the depth images.

    Raises
    ------
    DatasetError
        If there is no such bag or no such topic, or no transform leads to the camera.
    """
    bag = open_bag(path)
    return poses_recorded(
        bag,
        topic or find_odometry(bag, f"{OPTION}.topic"),
        camera_frame=camera_frame or _depth_frame(bag),
        world_frame=world_frame,
        max_gap_s=max_gap_s,
    )


def _depth_frame(bag: BagFile) -> str:
    try:
        first = bag.first(find_depth_topic(bag).name)
    except DatasetError as error:
        raise DatasetError(f"{error}; or give {OPTION}.camera_frame=FRAME") from error
    return str(first.header.frame_id)
