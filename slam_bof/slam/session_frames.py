"""The frames of a session: their checks, their poses, and the choice of keyframes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from slam_bof.core import Checkpoint
from slam_bof.geometry import CloudCamera, quantize_depth, restore_frame, se3
from slam_bof.slam.config import Config
from slam_bof.slam.frame_checks import FrameChecks, checked_pose, rotation_first
from slam_bof.slam.frame_history import FrameHistory
from slam_bof.tracking import KeyframeSelector, Track, Tracker
from slam_bof.types import LOST, Array, DepthFrame, FramePose, KeyframeRecord, Pose

__all__ = ["CheckedFrame", "CloudView", "SessionFrames", "TrackedFrame"]


class CheckedFrame(NamedTuple):
    """A frame with the camera and depths that the map uses, and what was given with it.

    ``step_covariance`` (6, 6) is that of odometry since the frame before, rotation first.
    """

    frame: DepthFrame
    T_odom_camera: Pose
    step_covariance: Array | None
    T_view_camera: Pose | None


@dataclass(frozen=True, slots=True, eq=False)
class TrackedFrame:
    """A frame as the map uses it, with its poses from odometry and tracking.

    ``index`` counts the frames of the session.
    """

    index: int
    frame: DepthFrame
    T_odom_raw: Pose
    track: Track


class CloudView(NamedTuple):
    """The depth image of a point cloud, the pose of its camera, and that of the sensor in it."""

    frame: DepthFrame
    T_odom_view: Pose
    T_view_camera: Pose


class SessionFrames:
    """Checks the frames, has their poses by odometry and tracking, and chooses keyframes.

    Attributes
    ----------
    session
        Number of the current session, from 0.
    history
        The poses of the frames of this session.
    newest
        The newest frame of this session, None before the first.
    tracker
        Tracks the frames between ``check`` and ``add``.
    """

    def __init__(self, config: Config) -> None:
        self.session = 0
        self.history = FrameHistory()
        self.newest: TrackedFrame | None = None
        self.tracker = Tracker(config.tracking, seed=config.seed)
        self._config = config
        self._checks = FrameChecks(config.sensor)
        self._cloud_camera = CloudCamera(config.gravity_odom, config.virtual_camera)
        self._selector = KeyframeSelector(config.keyframes)
        self._segment: int | None = None  # of this session's newest keyframe

    def check(
        self,
        frame: DepthFrame,
        T_odom_camera: Pose,
        covariance: ArrayLike | None = None,
        T_view_camera: Pose | None = None,
    ) -> CheckedFrame:
        """Check the next frame; see ``LoopCloser.process`` for parameters and errors."""
        index, stamp_s = len(self.history), frame.stamp_s
        step_covariance = None if covariance is None else rotation_first(covariance, index)
        T_odom_camera = checked_pose(T_odom_camera, index, stamp_s)
        if T_view_camera is not None:
            T_view_camera = checked_pose(T_view_camera, index, stamp_s, name="T_view_camera")
        is_first = self._checks.camera is None
        frame = self._checks.check(frame, self.history.last_stamp_s)
        if is_first and T_view_camera is not None and not frame.depth.any():
            self._checks.camera = None  # of an empty cloud; the next counts as the first
        frame = quantize_depth(frame.corrected(self._config.sensor))
        return CheckedFrame(frame, T_odom_camera, step_covariance, T_view_camera)

    def add(self, checked: CheckedFrame, track: Track) -> TrackedFrame:
        """Add a frame to those of the session, with what the tracker says of it."""
        frame, T_odom_raw, _, T_view_camera = checked
        index, segment = len(self.history), LOST if track.is_lost else track.segment
        self.history.frames.append(
            FramePose(frame.stamp_s, T_odom_raw, track.T_odom_camera, segment, T_view_camera)
        )
        if not track.is_lost and self._segment not in (None, track.segment):
            self._selector.reset()
            # The frame before has confirmed relocalisation: it belongs to the new segment.
            self.history.assign_previous(track.segment)
        self.newest = TrackedFrame(index, frame, T_odom_raw, track)
        return self.newest

    def project(self, stamp_s: float, points_camera: Array, T_odom_camera: Pose) -> CloudView:
        """Project a point cloud (N, 3) into the depth image of a virtual camera."""
        T_odom_camera = checked_pose(T_odom_camera, len(self.history), stamp_s)
        frame, T_camera_view = self._cloud_camera.observe(stamp_s, points_camera, T_odom_camera)
        return CloudView(frame, T_odom_camera @ T_camera_view, se3.inverse(T_camera_view))

    def choose_keyframe(self, tracked: TrackedFrame) -> bool:
        """Decide whether the newest frame becomes a keyframe, and remember it if so."""
        track = tracked.track
        return not track.is_lost and self._selector.select(
            tracked.index, track.T_odom_camera, inlier_ratio=track.inlier_ratio
        )

    def keep(self, tracked: TrackedFrame) -> None:
        """Align later frames with the newest frame, which has become a keyframe."""
        self.tracker.keep()
        self._segment = tracked.track.segment
        self.history.frames[-1] = replace(
            self.history.frames[-1], step_covariance=tracked.track.step_covariance
        )

    def begin_session(self, segment: int) -> None:
        """Begin a session with another odometry frame; its first segment is ``segment``."""
        self.session += 1
        self.history = FrameHistory()
        self.newest = self._segment = None
        self.tracker = Tracker(self._config.tracking, seed=self._config.seed, segment=segment)
        self._selector.reset()

    def state(self) -> dict[str, Any]:
        """Return the state that keyframes do not contain, as JSON values; the map adds its own."""
        return {
            "tracker": self.tracker.state(),
            "detector": None,
            "is_around": self._cloud_camera.is_around,
        }

    def replay(self, record: KeyframeRecord) -> None:
        """Take in the frames of a saved keyframe without tracking them."""
        self._checks.camera = record.depth.intrinsics
        self._segment = record.keyframe.segment
        self.history.frames.extend(record.frames)

    def restore(self, record: KeyframeRecord) -> None:
        """Restore the state at the newest keyframe, after all have been replayed."""
        frame = restore_frame(record.depth, record.keyframe.stamp_s)
        frame, last = frame.with_sensor(self._config.sensor), record.frames[-1]
        track = Track(last.T_odom_camera, False, last.segment, float("nan"))
        self.tracker.restore(record.state["tracker"], frame, track)
        self._selector.restore(record.keyframe.frame_index, last.T_odom_camera)
        if record.state["is_around"] is not None:
            self._cloud_camera.restore(record.depth.intrinsics, record.state["is_around"])

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present state; see ``core.Checkpoint``.

        Of the checks only the camera is restored: the stamp of a frame that was refused must stay
        known, since the next frame may confirm it.
        """
        before = Checkpoint()
        before.save_attributes(self, "session", "history", "newest", "tracker", "_segment")
        before.save_attributes(self._checks, "camera")
        before.save(self.history, self.tracker, self._selector, self._cloud_camera)
        return before.restore
