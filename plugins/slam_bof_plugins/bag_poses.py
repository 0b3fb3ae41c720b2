"""Poses recorded in a bag: odometry, stamped poses, and the tree of transforms (tf)."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from slam_bof.errors import DatasetError
from slam_bof.types import Array, Pose, Trajectory
from slam_bof_plugins.bag_file import BagFile
from slam_bof_plugins.dataset_files import poses_at
from slam_bof_plugins.ros_messages import clean_frame, pose_matrix, seconds, transform_matrix

__all__ = ["find_odometry", "poses_recorded", "recorded_poses"]

ODOMETRY = "nav_msgs/msg/Odometry"
POSE_STAMPED = "geometry_msgs/msg/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/msg/PoseWithCovarianceStamped"
TRANSFORM = "geometry_msgs/msg/TransformStamped"
TF = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
POSE_TYPES = (ODOMETRY, POSE_STAMPED, POSE_COVARIANCE, TRANSFORM, *TF)

STATIC = "tf_static"

Tree = dict[str, dict[str, Trajectory]]
"""For each frame and each of its parents, T_parent_frame over time.

A frame of a tree has one parent. A recording may hold several, where two publishers disagree.
"""


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
    comes from ``/tf_static``, or the ``tf_static`` of the same namespace; a message that names no
    child is taken as of the camera. Of tf, all transforms between ``world_frame`` and
    ``camera_frame`` are composed.

    Raises
    ------
    DatasetError
        If there is no such topic, it has no poses, or frames are not connected.
    """
    msgtype = _pose_type(bag, topic)
    if msgtype in TF:
        tree = _read_tree(bag, [topic, *_static_topics(bag, topic)])
        return _along(bag, tree, camera_frame, world_frame, stamps_s, max_gap_s)
    child, track = _read_poses(bag, topic, msgtype)
    T_world_child = poses_at(track, stamps_s, max_gap_s)
    return _to_camera(bag, topic, T_world_child, child, camera_frame)


def poses_recorded(
    bag: BagFile, topic: str, *, camera_frame: str, world_frame: str, max_gap_s: float
) -> Trajectory:
    """Return ``T_world_camera`` at the times of the poses themselves; as ``recorded_poses`` else.

    Of tf, these are the times of all transforms on the way that move.
    """
    msgtype = _pose_type(bag, topic)
    if msgtype in TF:
        tree = _read_tree(bag, [topic, *_static_topics(bag, topic)])
        way = _way(bag, tree, camera_frame, world_frame)
        tracks = [tree[child][parent] for child, parent in itertools.pairwise(way)]
        moving = [track.stamps_s for track in tracks if not _is_static(track)]
        stamps_s = np.unique(np.concatenate([np.empty(0), *moving]))
        return _along(bag, tree, camera_frame, world_frame, stamps_s, max_gap_s)
    child, track = _read_poses(bag, topic, msgtype)
    return _to_camera(bag, topic, track, child, camera_frame)


def find_odometry(bag: BagFile, option: str) -> str:
    """Return the topic of the odometry that a bag has, or of poses, or tf.

    Raises
    ------
    DatasetError
        If there is no such topic, or several; the message names the ``option`` that chooses.
    """
    for kinds in ((ODOMETRY,), (POSE_STAMPED, POSE_COVARIANCE, TRANSFORM), TF):
        names = [item.name for item in bag.topics if item.msgtype in kinds and item.n_messages]
        names = [name for name in names if not _is_static_topic(name)]
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


def _is_static_topic(topic: str) -> bool:
    return topic.rpartition("/")[2] == STATIC


def _static_topics(bag: BagFile, topic: str) -> list[str]:
    """Return the topics of static transforms in the innermost namespace of a topic that has one.

    One robot of several has its own: ``/robot1/tf_static`` belongs to ``/robot1/odom``.
    """
    known = {item.name for item in bag.topics}
    namespace = topic
    while namespace:
        namespace = namespace.rpartition("/")[0]
        if f"{namespace}/{STATIC}" in known:
            return [f"{namespace}/{STATIC}"]
    return []


def _to_camera(
    bag: BagFile, topic: str, T_world_child: Trajectory, child: str, camera: str
) -> Trajectory:
    """Transform poses of the moving frame to poses of the camera that is mounted on it."""
    if child in ("", clean_frame(camera)):
        return T_world_child
    stamps_s = T_world_child.stamps_s
    tree = _read_tree(bag, _static_topics(bag, topic))
    T_child_camera = _along(bag, tree, camera, child, stamps_s, np.inf)
    return Trajectory(stamps_s, T_world_child.poses @ T_child_camera.poses)


def _read_poses(bag: BagFile, topic: str, msgtype: str) -> tuple[str, Trajectory]:
    child = ""
    stamps_s, poses = [], []
    for _, message in bag.messages(topic):
        if msgtype == TRANSFORM:
            child = clean_frame(message.child_frame_id)
            T = transform_matrix(message.transform)
        else:
            if msgtype == ODOMETRY:
                child = clean_frame(message.child_frame_id)
            T = pose_matrix(message.pose if msgtype == POSE_STAMPED else message.pose.pose)
        stamps_s.append(seconds(message.header.stamp))
        poses.append(T)
    if not poses:
        raise DatasetError(f"{bag.path}: {topic}: found no messages, expected poses")
    return child, _in_order(stamps_s, poses)


def _read_tree(bag: BagFile, topics: list[str]) -> Tree:
    found: dict[tuple[str, str], tuple[list[float], list[Pose], bool]] = {}
    for topic in topics:
        for _, message in bag.messages(topic):
            for item in message.transforms:
                key = clean_frame(item.child_frame_id), clean_frame(item.header.frame_id)
                stamps_s, poses, _ = found.setdefault(key, ([], [], _is_static_topic(topic)))
                stamps_s.append(seconds(item.header.stamp))
                poses.append(transform_matrix(item.transform))
    tree: Tree = {}
    for (child, parent), (stamps_s, poses, is_static) in found.items():
        # What never moves holds at all times.
        track = (
            Trajectory(np.array([-np.inf, np.inf]), np.array([poses[-1], poses[-1]]))
            if is_static
            else _in_order(stamps_s, poses)
        )
        tree.setdefault(child, {})[parent] = track
    return tree


def _along(
    bag: BagFile, tree: Tree, frame: str, ancestor: str, stamps_s: Array, max_gap_s: float
) -> Trajectory:
    """Compose T_ancestor_frame at each stamp, link by link towards the root."""
    poses = np.tile(np.eye(4), (len(stamps_s), 1, 1))
    for child, parent in itertools.pairwise(_way(bag, tree, frame, ancestor)):
        track = tree[child][parent]
        T = track.poses[0] if _is_static(track) else poses_at(track, stamps_s, max_gap_s).poses
        poses = T @ poses
    return Trajectory(stamps_s, poses)


def _way(bag: BagFile, tree: Tree, frame: str, ancestor: str) -> list[str]:
    """Return the frames from one up to its ancestor.

    Where a frame has several parents, the way is the one that leads to the ancestor.
    """
    ways, found = [[clean_frame(frame)]], []
    for way in ways:
        if way[-1] == clean_frame(ancestor):
            found.append(way)
        else:
            parents = sorted(tree.get(way[-1], {}))
            ways += [[*way, parent] for parent in parents if parent not in way]
    if len(found) == 1:
        return found[0]
    if found:
        listed = " and ".join(" <- ".join(way) for way in found)
        raise DatasetError(f"{bag.path}: tf: found {len(found)} ways {listed}, expected one")
    reached = " and ".join(" <- ".join(way) for way in ways if way[-1] not in tree)
    raise DatasetError(
        f"{bag.path}: tf: found {reached or clean_frame(frame)}, expected a way up to "
        f"{clean_frame(ancestor)!r}; known frames: {', '.join(sorted(_frames(tree))) or 'none'}"
    )


def _is_static(track: Trajectory) -> bool:
    return bool(np.isinf(track.stamps_s).any())


def _frames(tree: Tree) -> Iterator[str]:
    yield from {frame for child, parents in tree.items() for frame in (child, *parents)}


def _in_order(stamps_s: list[float], poses: list[Pose]) -> Trajectory:
    """Put poses in the order of their times, the last of those with the same."""
    last = dict(zip(stamps_s, poses, strict=True))
    times = sorted(last)
    return Trajectory(np.array(times), np.array([last[t] for t in times]).reshape(-1, 4, 4))
