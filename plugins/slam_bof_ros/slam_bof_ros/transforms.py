"""The tree of transforms as far as this node needs it, from messages of tf2_msgs."""

from __future__ import annotations

import bisect
from collections.abc import Iterable
from typing import Any

import numpy as np

from slam_bof.geometry import se3
from slam_bof.types import Pose
from slam_bof_plugins.ros_messages import clean_frame, seconds, transform_matrix

__all__ = ["TransformTree"]

KEPT_S = 10.0
"""How long moving transforms are kept."""
TOLERANCE_S = 0.02
"""A transform so much older or newer than asked for is taken as it is."""


class _Track:
    """The pose of a frame in its parent, over time."""

    def __init__(self, parent: str) -> None:
        self.parent = parent
        self._stamps_s: list[float] = []
        self._poses: list[Pose] = []

    def add(self, stamp_s: float, T_parent_child: Pose) -> None:
        at = bisect.bisect_left(self._stamps_s, stamp_s)
        self._stamps_s.insert(at, stamp_s)
        self._poses.insert(at, T_parent_child)
        n_old = bisect.bisect_left(self._stamps_s, self._stamps_s[-1] - KEPT_S)
        del self._stamps_s[:n_old], self._poses[:n_old]

    def at(self, stamp_s: float) -> Pose | None:
        """Return the pose at a time, None if it is not known there."""
        after = bisect.bisect_left(self._stamps_s, stamp_s)
        near = [k for k in (after - 1, after) if 0 <= k < len(self._stamps_s)]
        if len(near) == 2:
            before_s, after_s = (self._stamps_s[k] for k in near)
            fraction = (stamp_s - before_s) / (after_s - before_s)
            return se3.interpolate(self._poses[near[0]], self._poses[near[1]], fraction)
        if near and abs(self._stamps_s[near[0]] - stamp_s) <= TOLERANCE_S:
            return self._poses[near[0]]
        return None


class TransformTree:
    """Transforms by their child frame, of ``/tf`` and ``/tf_static``."""

    def __init__(self) -> None:
        self._moving: dict[str, _Track] = {}
        self._static: dict[str, tuple[str, Pose]] = {}

    def add(self, transforms: Iterable[Any], *, is_static: bool) -> None:
        """Add geometry_msgs/TransformStamped; those that are no rigid transform are left out."""
        for item in transforms:
            child, parent = clean_frame(item.child_frame_id), clean_frame(item.header.frame_id)
            T = transform_matrix(item.transform)
            if not np.isfinite(T).all():
                continue
            if is_static:
                self._static[child] = parent, T
                continue
            if child not in self._moving or self._moving[child].parent != parent:
                self._moving[child] = _Track(parent)
            self._moving[child].add(seconds(item.header.stamp), T)

    def lookup(self, target: str, source: str, stamp_s: float) -> Pose | None:
        """Return ``T_target_source`` (4, 4) at a time; None if it is not known (yet).

        >>> TransformTree().lookup("odom", "odom", 0.0).shape
        (4, 4)
        """
        of_source = self._upwards(clean_frame(source), stamp_s)
        for frame, T_frame_target in self._upwards(clean_frame(target), stamp_s).items():
            if frame in of_source:
                return np.asarray(se3.inverse(T_frame_target) @ of_source[frame])
        return None

    def _upwards(self, frame: str, stamp_s: float) -> dict[str, Pose]:
        """Return ``T_ancestor_frame`` of a frame and all its ancestors, nearest first."""
        found, T = {frame: np.eye(4)}, np.eye(4)
        while True:
            if frame in self._static:
                parent, T_parent_frame = self._static[frame]
            elif frame in self._moving:
                track = self._moving[frame]
                at_stamp = track.at(stamp_s)
                if at_stamp is None:
                    return found
                parent, T_parent_frame = track.parent, at_stamp
            else:
                return found
            if parent in found:
                return found  # a circle
            T = T_parent_frame @ T
            found[parent] = T
            frame = parent
