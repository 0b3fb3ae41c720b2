"""Poses recorded in a bag: odometry, stamped poses, and the tree of transforms (tf)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.geometry import se3
from slam_bof.types import Array, Pose, Trajectory
from slam_bof_plugins.bag_file import BagFile
from slam_bof_plugins.dataset_files import poses_at

__all__ = ["find_odometry", "poses_recorded", "recorded_poses"]

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (ODOMETRY, POSE_STAMPED, POSE_COVARIANCE, TRANSFORM, *TF)

STATIC = "/tf_static"

Tree = dict[str, tuple[str, Trajectory]]
"""For each frame, its parent and T_parent_frame over time."""


def recorded_poses(
    bag: BagFile,
    topic: str,
    stamps_s: Array,
    *,
    camera_frame: str,
    world_frame: str,
    max_gap_s: float,
) -> Trajectory:
    """Return ``T_world_camera`` at each stamp (N,), NaN where unknown.

    Of a topic of poses, ``T_world_camera = T_world_child @ T_child_camera``, where the latter
    comes from ``/tf_static``; a message that names no child is taken as of the camera. Of tf, all
    transforms between ``world_frame`` and ``camera_frame`` are composed.

    Raises
    ------
    DatasetError
        If there is no such topic, it has no poses, or frames are not connected.
    """
    msgtype = _pose_type(bag, topic)
    if msgtype in TF:
        tree = _read_tree(bag, [topic, STATIC])
        return _along(bag, tree, camera_frame, world_frame, stamps_s, max_gap_s)
    child, track = _read_poses(bag, topic, msgtype)
    T_world_child = poses_at(track, stamps_s, max_gap_s)
    return _to_camera(bag, T_world_child, child, camera_frame)


def poses_recorded(
    bag: BagFile, topic: str, *, camera_frame: str, world_frame: str, max_gap_s: float
) -> Trajectory:
    """Return ``T_world_camera`` at the times of the poses themselves; as ``recorded_poses`` else.

    Of tf, these are the times of all transforms on the way that move.
    """
    msgtype = _pose_type(bag, topic)
    if msgtype in TF:
        tree = _read_tree(bag, [topic, STATIC])
        tracks = [tree[frame][1] for frame in _way(bag, tree, camera_frame, world_frame)]
        moving = [track.stamps_s for track in tracks if not _is_static(track)]
        stamps_s = np.unique(np.concatenate([np.empty(0), *moving]))
        return _along(bag, tree, camera_frame, world_frame, stamps_s, max_gap_s)
    child, track = _read_poses(bag, topic, msgtype)
    return _to_camera(bag, track, child, camera_frame)


def find_odometry(bag: BagFile, option: str) -> str:
    """Return the topic of the odometry that a bag has, or of poses, or tf.

    Raises
    ------
    DatasetError
        If there is no such topic, or several; the message names the ``option`` that chooses.
    """
    for kinds in ((ODOMETRY,), (POSE_STAMPED, POSE_COVARIANCE, TRANSFORM), TF):
        names = [item.name for item in bag.topics if item.msgtype in kinds and item.n_messages]
        names = [name for name in names if name != STATIC]
        if len(names) == 1:
            return names[0]
        if names:
            raise DatasetError(
                f"{bag.path}: found {len(names)} topics of poses: {', '.join(names)}, "
                f"expected one; choose by {option}={names[0]}"
            )
    listed = ", ".join(item.name for item in bag.topics) or "none"
    raise DatasetError(
        f"{bag.path}: found no poses (topics: {listed}), expected nav_msgs/Odometry, poses or tf"
    )


def _pose_type(bag: BagFile, topic: str) -> str:
    """Return the type of a topic, if it is one of poses."""
    types = {item.name: item.msgtype for item in bag.topics}
    found = types.get(topic, "no such topic")
    if found not in POSE_TYPES:
        usable = [item.name for item in bag.topics if item.msgtype in POSE_TYPES]
        raise DatasetError(
            f"{bag.path}: {topic}: found {found}, "
            f"expected poses: {', '.join(usable) or 'none here'}"
        )
    return found


def _to_camera(bag: BagFile, T_world_child: Trajectory, child: str, camera: str) -> Trajectory:
    """Transform poses of the moving frame to poses of the camera that is mounted on it."""
    if child in ("", _clean(camera)):
        return T_world_child
    stamps_s = T_world_child.stamps_s
    T_child_camera = _along(bag, _read_tree(bag, [STATIC]), camera, child, stamps_s, np.inf)
    return Trajectory(stamps_s, T_world_child.poses @ T_child_camera.poses)


def _read_poses(bag: BagFile, topic: str, msgtype: str) -> tuple[str, Trajectory]:
    child = ""
    stamps_s, poses = [], []
    for _, message in bag.messages(topic):
        if msgtype == TRANSFORM:
            child = _clean(message.child_frame_id)
            T = _transform(message.transform)
        else:
            if msgtype == ODOMETRY:
                child = _clean(message.child_frame_id)
            T = _pose(message.pose if msgtype == POSE_STAMPED else message.pose.pose)
        stamps_s.append(_seconds(message.header.stamp))
        poses.append(T)
    if not poses:
        raise DatasetError(f"{bag.path}: {topic}: found no messages, expected poses")
    return child, _in_order(stamps_s, poses)


def _read_tree(bag: BagFile, topics: list[str]) -> Tree:
    found: dict[str, tuple[str, list[float], list[Pose], bool]] = {}
    known = {item.name for item in bag.topics}
    for topic in sorted(known & set(topics)):
        for _, message in bag.messages(topic):
            for item in message.transforms:
                parent, child = _clean(item.header.frame_id), _clean(item.child_frame_id)
                _, stamps_s, poses, _ = found.setdefault(child, (parent, [], [], topic == STATIC))
                stamps_s.append(_seconds(item.header.stamp))
                poses.append(_transform(item.transform))
    tree: Tree = {}
    for child, (parent, stamps_s, poses, is_static) in found.items():
        # What never moves holds at all times.
        track = (
            Trajectory(np.array([-np.inf, np.inf]), np.array([poses[-1], poses[-1]]))
            if is_static
            else _in_order(stamps_s, poses)
        )
        tree[child] = (parent, track)
    return tree


def _along(
    bag: BagFile, tree: Tree, frame: str, ancestor: str, stamps_s: Array, max_gap_s: float
) -> Trajectory:
    """Compose T_ancestor_frame at each stamp, link by link towards the root."""
    poses = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    for passed in _way(bag, tree, frame, ancestor):
        _, track = tree[passed]
        T = track.poses[0] if _is_static(track) else poses_at(track, stamps_s, max_gap_s).poses
        poses = T @ poses
    return Trajectory(stamps_s, poses)


def _way(bag: BagFile, tree: Tree, frame: str, ancestor: str) -> list[str]:
    """Return the frames from one up to the last below its ancestor."""
    passed = [_clean(frame)]
    while passed[-1] != _clean(ancestor):
        if passed[-1] not in tree or tree[passed[-1]][0] in passed:
            raise DatasetError(
                f"{bag.path}: tf: found {' <- '.join(passed)}, expected a way up to "
                f"{_clean(ancestor)!r}; known frames: {', '.join(sorted(_frames(tree))) or 'none'}"
            )
        passed.append(tree[passed[-1]][0])
    return passed[:-1]


def _is_static(track: Trajectory) -> bool:
    return bool(np.isinf(track.stamps_s).any())


def _frames(tree: Tree) -> Iterator[str]:
    yield from {frame for child, (parent, _) in tree.items() for frame in (child, parent)}


def _in_order(stamps_s: list[float], poses: list[Pose]) -> Trajectory:
    """Put poses in the order of their times, the last of those with the same."""
    last = dict(zip(stamps_s, poses, strict=True))
    times = sorted(last)
    return Trajectory(np.array(times), np.array([last[t] for t in times]).reshape(-1, 4, 4))


def _clean(frame: str) -> str:
    return frame.removeprefix("/")


def _seconds(stamp: Any) -> float:
    return float(stamp.sec + stamp.nanosec * 1e-9)


def _pose(pose: Any) -> Pose:
    return _matrix(pose.orientation, pose.position)


def _transform(transform: Any) -> Pose:
    return _matrix(transform.rotation, transform.translation)


def _matrix(q: Any, t: Any) -> Pose:
    quaternion = np.array([q.x, q.y, q.z, q.w])
    if not 0.5 < np.linalg.norm(quaternion) < 2.0:
        return np.full((4, 4), np.nan)  # all zeros: the writer knew no pose
    return se3.from_quaternion(quaternion, (t.x, t.y, t.z))
