"""The plug-in for an existing odometry: ``process`` each frame, then ``finish``."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.core import Checkpoint, StageClock, one_blas_thread
from slam_bof.errors import FrameError
from slam_bof.geometry import (
    CloudCamera,
    quantize_depth,
    restore_frame,
    se3,
    subsample,
)
from slam_bof.loops import Verified
from slam_bof.slam.config import Config, preset, resolve
from slam_bof.slam.frame_history import FrameHistory
from slam_bof.slam.keyframe_map import KeyframeMap
from slam_bof.tracking import KeyframeSelector, Track, Tracker
from slam_bof.types import (
    LOST,
    Array,
    DepthFrame,
    FramePose,
    Intrinsics,
    Keyframe,
    KeyframeRecord,
    Pose,
    Step,
    Trajectory,
)

__all__ = ["Journal", "LoopCloser"]

MAX_JUMP_S = 86_400.0
"""A stamp farther ahead of the last than this is broken, unless the next frame confirms it."""

Journal = Callable[[KeyframeRecord], None]
"""Called with the record of each new keyframe to save it, such as ``MapWriter.write``. What it
raises ends the call of the loop closer, which has processed the frame all the same; the record
comes again before that of the next keyframe, and at the end."""


class LoopCloser:
    """Adds loop closing, map correction and scene labels to your own odometry.

    A call happens whole or not at all: after an exception or Ctrl-C in it, the next call goes on
    from the frame before. Calls from several threads wait for each other.

    >>> closer = LoopCloser.from_preset("indoor")  # doctest: +SKIP
    >>> for frame, T_odom_camera in my_odometry:  # doctest: +SKIP
    ...     step = closer.process(frame, T_odom_camera)
    ...     T_map_camera = step.T_map_odom @ T_odom_camera
    >>> trajectory = closer.finish()  # doctest: +SKIP
    """

    def __init__(
        self,
        config: Config,
        *,
        journal: Journal | None = None,
        clock: StageClock | None = None,
    ) -> None:
        self.history = FrameHistory()
        self.journal = journal
        """Called with the record of each new keyframe, if not None."""
        self._tracker = Tracker(config.tracking, seed=config.seed)
        self._selector = KeyframeSelector(config.keyframes)
        self._clock = clock or StageClock()
        self._config = config
        self._map = KeyframeMap(config, self._clock)
        self._camera: Intrinsics | None = None
        self._refused_stamp_s = -np.inf
        self._unsaved: list[KeyframeRecord] = []
        self._lock = threading.Lock()
        self._owner: int | None = None
        self._before: Checkpoint | None = None
        self._cloud_camera = CloudCamera(config.gravity_odom, config.virtual_camera)

    @classmethod
    def from_preset(cls, name: str = "indoor", *, journal: Journal | None = None) -> Self:
        """Build a loop closer from a preset by name: ``indoor`` or ``paper``."""
        return cls.from_config(preset(name), journal=journal)

    @classmethod
    def from_config(
        cls,
        config: Config | str | Path,
        *,
        journal: Journal | None = None,
        clock: StageClock | None = None,
    ) -> Self:
        """Build a loop closer from a configuration, the name of a preset or of a YAML file.

        ``journal`` is called with the record of each new keyframe.
        """
        config = config if isinstance(config, Config) else resolve(str(config))
        return cls(config, journal=journal, clock=clock)

    @one_blas_thread()
    def process(
        self,
        frame: DepthFrame,
        T_odom_camera: Pose,
        covariance: ArrayLike | None = None,
        *,
        T_view_camera: Pose | None = None,
    ) -> Step:
        """Process a frame and its odometry pose (4, 4); return the correction by the map.

        Parameters
        ----------
        frame
            The depth image. Intrinsics that vary a little from frame to frame, as with autofocus,
            count as those of the first frame; see ``Intrinsics.is_close``.
        T_odom_camera
            (4, 4) pose of the camera in the odometry frame.
        covariance
            (6, 6) or (36,) covariance of the odometry's step since the frame before, in m^2 and
            rad^2, in the order of ``nav_msgs/Odometry``: x, y, z, then rotations about them, along
            the axes of the camera. With it, odometry is corrected only as far as it may be wrong.
            Without it, the noise of odometry is learnt from its differences to alignment.
        T_view_camera
            (4, 4) pose of the sensor in the camera of the frame, if the frame was projected from a
            point cloud; see ``FramePose``.

        Raises
        ------
        FrameError
            If the time stamp does not increase, or is more than a day ahead of the frame before;
            if the camera differs from that of the frames before; if the pose is not a finite rigid
            transform; or if the covariance is not positive semidefinite. It is a ``ValueError``
            too. Such a frame is ignored, and the next call may continue. A jump of the clock is
            accepted with the next frame that confirms it.
        RuntimeError
            If it is called from inside another call, such as by the journal.
        """
        with self._whole() as before:
            return self._process(before, frame, T_odom_camera, covariance, T_view_camera)

    def _process(
        self,
        before: Checkpoint,
        frame: DepthFrame,
        T_odom_camera: Pose,
        covariance: ArrayLike | None,
        T_view_camera: Pose | None,
    ) -> Step:
        """Process a frame; ``before`` is the state to return to if that fails."""
        frame_index = len(self.history)
        step_covariance = None if covariance is None else _rotation_first(covariance, frame_index)
        frame, T_odom_camera = self._check(frame, T_odom_camera)
        frame = quantize_depth(frame.with_sensor(self._config.sensor))
        with self._clock.stage("track"):
            track = self._tracker.track(frame, T_odom_camera, step_covariance)
        segment = LOST if track.is_lost else track.segment
        self.history.frames.append(
            FramePose(frame.stamp_s, T_odom_camera, track.T_odom_camera, segment, T_view_camera)
        )
        if self._begins_segment(track):
            self._selector.reset()
            # Relocalisation was confirmed by the frame before, so it belongs to the new segment.
            self.history.assign_previous(track.segment)
        if not track.is_lost and self._selector.select(
            frame_index, track.T_odom_camera, inlier_ratio=track.inlier_ratio
        ):
            before.save(self._map)
            self._tracker.keep()
            self.history.frames[-1] = replace(
                self.history.frames[-1], step_covariance=track.step_covariance
            )
            unsaved = tuple(self.frames_since_keyframe)
            keyframe = self._map.describe(
                frame_index,
                frame,
                track.T_odom_camera,
                segment=track.segment,
                step_covariance=track.step_covariance,
            )
            verified = self._map.add(keyframe, frame)
            self._record(keyframe, frame, unsaved, verified)
            loops, candidates = tuple(verified.admitted), tuple(verified.candidates)
            step = Step(keyframe, keyframe.scene, loops, candidates, np.eye(4))
        else:
            scene = self._map.keyframes[-1].scene if self._map.keyframes else None
            step = Step(None, scene, (), (), np.eye(4), is_lost=track.is_lost)
        T_map_camera = self._map.T_map_track @ track.T_odom_camera
        T_map_odom = T_map_camera @ se3.inverse(T_odom_camera)
        return replace(step, T_map_odom=T_map_odom, open_axes=track.open_axes)

    @one_blas_thread()
    def process_points(self, stamp_s: float, points_camera: Array, T_odom_camera: Pose) -> Step:
        """Process a point cloud instead of a depth image, like ``process``.

        The cloud of a depth camera is projected into a depth image. The cloud of a sensor that
        sees all around, such as a LiDAR, is projected into a level virtual camera with a fixed
        direction in the odometry frame: forward in the first pose. ``step.keyframe`` and
        ``step.loops`` refer to that virtual camera. The type of the sensor is determined from the
        first cloud with at least 100 points; see ``geometry.CloudCamera``.

        Parameters
        ----------
        stamp_s
            Time in seconds, on any clock that increases.
        points_camera
            (N, 3) in metres, x right, y down, z forward. Rows that are not finite are dropped.
        T_odom_camera
            (4, 4) pose of the sensor in the odometry frame.

        Raises
        ------
        FrameError
            In the cases of ``process``.
        ValueError
            If the points are not (N, 3).
        """
        with self._whole() as before:
            T_odom_camera = self._check_pose(stamp_s, T_odom_camera)
            has_camera = self._camera is not None
            frame, T_camera_view = self._cloud_camera.observe(stamp_s, points_camera, T_odom_camera)
            T_odom_view, T_view_camera = T_odom_camera @ T_camera_view, se3.inverse(T_camera_view)
            step = self._process(before, frame, T_odom_view, None, T_view_camera)
            if not has_camera and not frame.depth.any():
                self._camera = None  # the cloud was empty, so the next camera counts as the first
            return step

    def finish(self) -> Trajectory:
        """Optimise the whole graph; return ``T_map_camera`` of every frame of this session.

        Without any keyframe, because all frames were empty, this is the odometry. Loops that
        contradict the others move from ``loops`` to ``loops_left_out``. It may be called again.

        Keyframes that the journal could not save are passed to it again. If it fails again, set
        ``journal`` to None and call once more to get the trajectory all the same.
        """
        with self._whole() as before:
            before.save(self._map)
            with self._clock.stage("optimize"):
                self._map.graph.optimize()
            own = self._map.of_session
            poses = self._map.poses()[self._map.first_keyframe :] if own else None
            return self.history.trajectory(own, poses)

    @one_blas_thread()
    def restore(self, records: Iterable[KeyframeRecord]) -> None:
        """Restore a saved map (``replay_keyframes``), to continue after its newest keyframe.

        The next frame must be the one after that keyframe, with the same odometry; otherwise call
        ``begin_session`` first. All results are the same as without the interruption.

        Raises
        ------
        ValueError
            If this loop closer has processed frames before.
        """
        with self._whole() as before:
            before.save(self._map)
            self._restore(records)

    def _restore(self, records: Iterable[KeyframeRecord]) -> None:
        """Do what ``restore`` says."""
        if self._map.keyframes or len(self.history):
            raise ValueError("only a new loop closer can restore a saved map")
        record = None
        for record in records:
            while self._map.session < record.keyframe.session:
                self._begin_session()
            self._camera = record.depth.intrinsics
            self.history.frames.extend(record.frames)
            self._map.replay(record)
        if record is None or not record.state:
            return  # a pruned map cannot be resumed, only continued by another session
        frame = restore_frame(record.depth, record.keyframe.stamp_s)
        frame, last = frame.with_sensor(self._config.sensor), record.frames[-1]
        track = Track(last.T_odom_camera, False, last.segment, float("nan"))
        self._tracker.restore(record.state["tracker"], frame, track)
        self._selector.restore(record.keyframe.frame_index, last.T_odom_camera)
        self._map.restore(record.state["detector"])
        if record.state["is_around"] is not None:
            self._cloud_camera.restore(record.depth.intrinsics, record.state["is_around"])

    def begin_session(self) -> None:
        """Begin a session: the next frames have another odometry frame, in the same place.

        The clock may restart. The new keyframes form a separate component of the pose graph until
        loops join it to the earlier ones.
        """
        with self._whole() as before:
            before.save(self._map)
            self._begin_session()

    def _begin_session(self) -> None:
        """Do what ``begin_session`` says."""
        self._map.begin_session()
        self.history = FrameHistory()
        segment = self._map.keyframes[-1].segment + 1 if self._map.keyframes else 0
        self._tracker = Tracker(self._config.tracking, seed=self._config.seed, segment=segment)
        self._selector.reset()

    @property
    def map(self) -> KeyframeMap:
        """The keyframes, their pose graph and their loops, for reading only."""
        return self._map

    @property
    def n_odometry_lost(self) -> int:
        """Number of times that odometry was lost in this session."""
        return self._tracker.n_lost

    @property
    def n_frames_lost(self) -> int:
        """Number of frames of this session whose pose is unknown."""
        return self.history.n_lost

    @property
    def frames_since_keyframe(self) -> list[FramePose]:
        """The frames of this session after its newest keyframe."""
        own = self._map.of_session
        return self.history.frames[own[-1].frame_index + 1 if own else 0 :]

    def _check(self, frame: DepthFrame, T_odom_camera: Pose) -> tuple[DepthFrame, Pose]:
        """Check the input of ``process``; return it by the first frame's camera, and as float64."""
        self._check_stamp(frame.stamp_s)
        camera = self._camera or frame.intrinsics
        if not frame.intrinsics.is_close(camera):
            raise FrameError(f"frames must all be of {camera}, got one of {frame.intrinsics}")
        if frame.intrinsics != camera:
            frame = replace(frame, intrinsics=camera)
        T_odom_camera = self._check_pose(frame.stamp_s, T_odom_camera)
        self._camera = camera
        return frame, T_odom_camera

    def _check_pose(self, stamp_s: float, T_odom_camera: ArrayLike) -> Pose:
        """Check the pose of the next frame; return a copy of it as float64."""
        try:
            T = np.array(T_odom_camera, dtype=np.float64)
            if T.shape == (3, 4):
                raise ValueError("found a (3, 4) matrix, expected (4, 4): its last row is 0 0 0 1")
            se3.check_rigid(T)
        except (TypeError, ValueError) as error:
            place = f"T_odom_camera of frame {len(self.history)}, at {stamp_s} s"
            raise FrameError(f"{place}: {error}") from None
        T[3] = se3.LAST_ROW
        return T

    def _check_stamp(self, stamp_s: float) -> None:
        """Refuse a stamp that does not increase, or a jump that no frame before confirms."""
        last_s, refused_s = self.history.last_stamp_s, self._refused_stamp_s
        if not last_s < stamp_s < np.inf:
            raise FrameError(f"time stamps must increase, got {stamp_s} s after {last_s} s")
        is_confirmed = 0.0 < stamp_s - refused_s <= MAX_JUMP_S
        if last_s > -np.inf and stamp_s - last_s > MAX_JUMP_S and not is_confirmed:
            self._refused_stamp_s = stamp_s
            raise FrameError(
                f"time stamps must be in seconds, got {stamp_s} s more than a day after {last_s} s"
            )

    def _begins_segment(self, track: Track) -> bool:
        """Return whether tracking has resumed after a loss, in a new segment."""
        return (
            not track.is_lost
            and len(self._map.keyframes) > self._map.first_keyframe
            and self._map.keyframes[-1].segment != track.segment
        )

    @contextmanager
    def _whole(self) -> Iterator[Checkpoint]:
        """Run a call alone. If it does not come to its end, take back all that it did."""
        if self._lock.locked() and self._owner == threading.get_ident():
            raise RuntimeError("called from inside another call of the same loop closer")
        with self._lock:
            try:
                self._owner = threading.get_ident()
                self._take_back()
                before = Checkpoint()
                before.save_attributes(self, "history", "_tracker", "_camera")
                before.save(self.history, self._tracker, self._selector, self._cloud_camera)
                before.save(self._unsaved)
                self._before = before
                yield before
                self._before = None
                self._save()
            except BaseException:
                self._take_back()
                raise
            finally:
                self._owner = None

    def _take_back(self) -> None:
        """Return to the state before a call that did not come to its end, if there was one."""
        if self._before is not None:
            self._before.restore()
            self._before = None

    def _save(self) -> None:
        """Pass the records of new keyframes to the journal, oldest first."""
        with self._clock.stage("save"):
            while self._unsaved and self.journal is not None:
                self.journal(self._unsaved[0])
                del self._unsaved[0]

    def _record(
        self,
        keyframe: Keyframe,
        frame: DepthFrame,
        unsaved: tuple[FramePose, ...],
        verified: Verified,
    ) -> None:
        """Make the record of a new keyframe for the journal."""
        if self.journal is None:
            return
        with self._clock.stage("save"):
            record = KeyframeRecord(
                keyframe=keyframe,
                depth=subsample(frame),
                frames=unsaved,
                candidates=tuple(verified.candidates),
                measured=tuple(verified.measured),
                admitted=tuple(verified.admitted),
                state={
                    "tracker": self._tracker.state(),
                    "detector": self._map.state(),
                    "is_around": self._cloud_camera.is_around,
                },
            )
            self._unsaved.append(record)


def _rotation_first(covariance: ArrayLike, frame_index: int) -> Array:
    """Check a covariance in the order of ``nav_msgs/Odometry``; return it with rotation first."""
    found = np.asarray(covariance, dtype=np.float64)
    place = f"covariance of frame {frame_index}"
    if found.size != 36:
        raise FrameError(f"{place}: found an array {found.shape}, expected (6, 6)")
    found = found.reshape(6, 6)
    if not np.isfinite(found).all() or np.abs(found - found.T).max() > 1e-6 * np.abs(found).max():
        raise FrameError(f"{place}: expected 36 finite numbers, symmetric")
    if np.linalg.eigvalsh(found)[0] < -1e-9 * max(float(np.trace(found)), 1e-30):
        raise FrameError(f"{place}: expected no negative variance in any direction")
    order = [3, 4, 5, 0, 1, 2]
    return np.asarray(found[np.ix_(order, order)])
