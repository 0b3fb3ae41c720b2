"""Keyframes, what is saved with them, and the result of processing a frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.types.depth import SubsampledDepth
from slam_bof.types.features import Bag, SavedConstellation, Scene
from slam_bof.types.loops import Candidate, Loop
from slam_bof.types.poses import Array, FramePose, Pose

__all__ = ["Keyframe", "KeyframeRecord", "OdometryState", "Step"]


@dataclass(frozen=True, slots=True, eq=False)
class Keyframe:
    """A frame that the map keeps.

    ``id`` counts keyframes and ``frame_index`` counts frames. ``T_odom_camera`` and ``segment``
    are defined in ``tracking.Track``. ``scene`` is the label of this keyframe alone; ``smoothed``
    also takes the keyframes before it into account. ``session`` is the number of the run, from 0,
    that the keyframe comes from: a map may hold several runs, each with its own frames and
    odometry. ``step_covariance`` (6, 6) is that of the step since the keyframe before, rotation
    first in rad^2 and m^2, and None where the odometry's covariance is not known. ``T_odom_raw`` is
    the pose from odometry as it was given.
    """

    id: int
    frame_index: int
    stamp_s: float
    T_odom_camera: Pose
    bag: Bag
    scene: Scene | None
    segment: int = 0
    smoothed: Scene | None = None
    session: int = 0
    step_covariance: Array | None = None
    T_odom_raw: Pose | None = None


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeRecord:
    """Everything that is saved with a keyframe, enough to resume the run after it.

    ``frames`` are the frames after the keyframe before, up to and including this one.
    ``measured`` are the loops of this keyframe that geometry verified. ``admitted`` are the loops
    that entered the graph with it, in that order: some of ``measured`` may be missing, and held
    loops of earlier keyframes may be among them. ``culled`` are the ids of the keyframes that were
    culled with it, each with the id of its anchor, to which its pose is fixed. ``state`` is the
    remaining state of the plug-in as JSON values. ``constellation`` is None if the keyframe was not
    described by one.
    """

    keyframe: Keyframe
    depth: SubsampledDepth
    frames: tuple[FramePose, ...]
    candidates: tuple[Candidate, ...]
    measured: tuple[Loop, ...]
    admitted: tuple[Loop, ...]
    state: dict[str, Any]
    culled: tuple[tuple[int, int], ...] = ()
    constellation: SavedConstellation | None = None


@dataclass(frozen=True, slots=True, eq=False)
class OdometryState:
    """The state of an odometry after a keyframe, to resume the run without repeating it.

    ``frame_index`` is that of the keyframe, ``skipped`` (n,) are the indices of frames of the data
    set before it that could not be used, and ``arrays`` are what ``ResumableOdometry.state``
    returned.
    """

    frame_index: int
    skipped: NDArray[np.int64]
    arrays: Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """The result of processing one frame.

    ``keyframe`` is the newest keyframe that has come into the map since the step before, None if
    none has. It is this frame, unless keyframes are processed in the background: ``is_keyframe``
    says that this frame becomes one. ``scene`` is the latest label. ``loops`` are the edges that
    were accepted since the step before, and ``candidates`` are all pairs that were considered.
    ``T_map_odom`` corrects the odometry frame (REP 105): ``T_map_camera = T_map_odom @
    T_odom_camera``. If ``is_lost`` is true, the odometry pose is wrong and no better one is known.
    ``open_axes`` (6, k) are the directions in which the surfaces in sight hold nothing, as tangents
    of the camera's pose, rotation first; the pose along them is that of odometry. ``T_map_camera``
    is the pose of the frame in the map; None for a frame that was restored from an interrupted run.
    ``covariance`` (6, 6) is that of ``T_map_camera`` relative to the first keyframe of its part of
    the map, in m^2 and rad^2, in the order of ``nav_msgs/Odometry``: x, y, z, then rotations about
    them, along the axes of the camera. Along ``open_axes``, and all over while lost, it is huge.
    """

    keyframe: Keyframe | None
    scene: Scene | None
    loops: tuple[Loop, ...]
    candidates: tuple[Candidate, ...]
    T_map_odom: Pose
    is_lost: bool = False
    open_axes: Array = field(default_factory=lambda: np.empty((6, 0)))
    T_map_camera: Pose | None = None
    covariance: Array | None = None
    is_keyframe: bool = False

    @property
    def health(self) -> str:
        """How the frame was tracked: ``tracked``, ``degenerate`` or ``lost``.

        It is ``unknown`` for a frame that was restored, whose open directions a map does not keep.
        """
        if self.is_lost:
            return "lost"
        if self.T_map_camera is None:
            return "unknown"
        return "degenerate" if self.open_axes.shape[1] else "tracked"
