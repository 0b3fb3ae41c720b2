"""The plug-in for an existing odometry: ``process`` each frame, then ``finish``."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Self

from numpy.typing import ArrayLike

from slam_bof.bof import compile_bof
from slam_bof.core import Checkpoint, StageClock, one_blas_thread
from slam_bof.errors import FrameWarning
from slam_bof.geometry import compile_alignment, se3
from slam_bof.slam.background import BackgroundMapping
from slam_bof.slam.config import Config, preset, resolve
from slam_bof.slam.frame_history import FrameHistory
from slam_bof.slam.keyframe_map import KeyframeMap
from slam_bof.slam.map_updates import Journal, MapUpdates
from slam_bof.slam.mapping import DirectMapping, KeyframeJob, Mapping, MapUpdate
from slam_bof.slam.odometry_doubts import find_odometry_doubts
from slam_bof.slam.session_frames import SessionFrames, TrackedFrame
from slam_bof.slam.whole_calls import WholeCalls
from slam_bof.types import (
    Array,
    DepthFrame,
    FramePose,
    KeyframeRecord,
    Pose,
    Step,
    Trajectory,
)

__all__ = ["LoopCloser"]


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
        background: bool = False,
    ) -> None:
        compile_alignment()
        if not background:
            compile_bof()
        self.config = config
        """The configuration, for reading only."""
        self.journal = journal
        """Called with the record of each new keyframe, if not None."""
        self.n_postponed = 0
        """Number of frames that came while too many keyframes waited for one more."""
        self._clock = clock or StageClock()
        self._frames = SessionFrames(config)
        mapping = BackgroundMapping if background else DirectMapping
        self._mapping: Mapping = mapping(config, self._clock)
        self._map = self._mapping.map
        self._updates = MapUpdates()
        self._calls = WholeCalls()

    @classmethod
    def from_preset(
        cls,
        name: str = "indoor",
        *,
        journal: Journal | None = None,
        background: bool = False,
    ) -> Self:
        """Build one from a preset by name, ``indoor`` or ``paper``; see ``from_config``."""
        return cls.from_config(preset(name), journal=journal, background=background)

    @classmethod
    def from_config(
        cls,
        config: Config | str | Path,
        *,
        journal: Journal | None = None,
        clock: StageClock | None = None,
        background: bool = False,
    ) -> Self:
        """Build a loop closer from a configuration, the name of a preset or of a YAML file.

        Parameters
        ----------
        config
            The configuration, or the name of a preset or of a YAML file.
        journal
            Is called with the record of each new keyframe.
        clock
            Adds up the time that each stage takes.
        background
            Whether keyframes are described, searched for, verified and optimised in a process of
            their own, so that ``process`` only tracks. What came of a keyframe is then returned by
            a later call, and an error of it is raised by one. While 8 keyframes wait, no frame
            becomes a keyframe (``n_postponed``); none is dropped.
        """
        config = config if isinstance(config, Config) else resolve(str(config))
        return cls(config, journal=journal, clock=clock, background=background)

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
        Exception
            In the background, what an earlier keyframe has raised, which is then not in the map.
            This frame has not been processed, and may be given again.
        """
        with self._call() as before:
            checked = self._frames.check(frame, T_odom_camera, covariance, T_view_camera)
            with self._clock.stage("track"):
                track = self._frames.tracker.track(
                    checked.frame, checked.T_odom_camera, checked.step_covariance
                )
            tracked = self._frames.add(checked, track)
            is_keyframe = self._has_room() and self._frames.choose_keyframe(tracked)
            if is_keyframe:
                before.save(self._mapping)
                self._frames.keep(tracked)
                state = None if self.journal is None else self._frames.state()
                update = self._mapping.submit(KeyframeJob(tracked, state))
                if update is not None:
                    self._apply(update)
            return replace(self._step(tracked), is_keyframe=is_keyframe)

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
        with self._call():
            view = self._frames.project(stamp_s, points_camera, T_odom_camera)
            return self.process(view.frame, view.T_odom_view, T_view_camera=view.T_view_camera)

    def finish(self) -> Trajectory:
        """Optimise the whole graph; return ``T_map_camera`` of every frame of this session.

        Without any keyframe, because all frames were empty, this is the odometry. Loops that
        contradict the others move from ``loops`` to ``loops_left_out``. It may be called again.
        Odometry that turns about other axes than depth shows, or moves by another unit, is warned
        of (``FrameWarning``).

        Keyframes that the journal could not save are passed to it again. If it fails again, set
        ``journal`` to None and call once more to get the trajectory all the same.
        """
        with self._call(wait=True) as before:
            before.save(self._mapping)
            with self._clock.stage("optimize"):
                self._map.graph.optimize()
            own = self._map.of_session
            poses = self._map.poses()[self._map.first_keyframe :] if own else None
            trajectory = self.history.trajectory(own, poses)
        for doubt in find_odometry_doubts(self.history.frames):
            warnings.warn(doubt, FrameWarning, stacklevel=2)
        return trajectory

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
        with self._call(wait=True) as before:
            before.save(self._mapping)
            if self._map.keyframes or len(self.history):
                raise ValueError("only a new loop closer can restore a saved map")
            record = None
            for record in records:
                while self._map.session < record.keyframe.session:
                    self._begin_session()
                self._frames.replay(record)
                self._map.replay(record)
                self._updates.newest = record.keyframe
            if record is None:
                return
            self._updates.T_map_track = self._map.T_map_track
            self._updates.uncertainty = self._map.uncertainty()
            if record.state:  # a pruned map has none: another session continues it
                self._frames.restore(record)
                self._frames.tracker.trusts_odometry = self._map.trusts_odometry
                self._map.restore(record.state["detector"])

    def begin_session(self) -> None:
        """Begin a session: the next frames have another odometry frame, in the same place.

        The clock may restart. The new keyframes form a separate component of the pose graph until
        loops join it to the earlier ones.
        """
        with self._call(wait=True) as before:
            before.save(self._mapping)
            self._begin_session()

    def poll(self) -> Step | None:
        """Return the step of the newest frame as it is now; None before the first frame.

        Between frames, or after the last, it brings what came of keyframes in the background.
        """
        with self._call():
            newest = self._frames.newest
            return None if newest is None else self._step(newest)

    def drain(self) -> None:
        """Wait until all keyframes so far are in the map; the next step returns what came of them.

        Raises
        ------
        Exception
            If a keyframe could not be processed in the background.
        """
        with self._call(wait=True):
            pass

    def close(self) -> None:
        """End the process in the background, if there is one; this loop closer is of no use then.

        It ends by itself when the loop closer is garbage, or the program ends.
        """
        self._mapping.close()

    @property
    def map(self) -> KeyframeMap:
        """The keyframes, their pose graph and their loops, for reading only.

        In the background, each attribute is that of the moment when all keyframes so far are in the
        map; to read it waits until then.
        """
        return self._map

    @property
    def history(self) -> FrameHistory:
        """The poses of all frames of this session, for reading only."""
        return self._frames.history

    @property
    def n_waiting(self) -> int:
        """Number of keyframes that are not in the map yet; 0 unless in the background."""
        return self._mapping.n_waiting

    @property
    def n_odometry_lost(self) -> int:
        """Number of times that odometry was lost in this session."""
        return self._frames.tracker.n_lost

    @property
    def n_frames_lost(self) -> int:
        """Number of frames of this session whose pose is unknown."""
        return self.history.n_lost

    @property
    def frames_since_keyframe(self) -> list[FramePose]:
        """The frames of this session after its newest keyframe."""
        return self.history.frames[self._updates.first_frame_after(self._frames.session) :]

    def _has_room(self) -> bool:
        """Return whether another keyframe may wait for the map; count the frame if not."""
        is_full = self._mapping.is_full
        self.n_postponed += is_full
        return not is_full

    def _step(self, tracked: TrackedFrame) -> Step:
        """Return the result of a frame, and of the keyframes that are in the map since the last."""
        updates, newest = self._updates.take(), self._updates.newest
        track = tracked.track
        T_map_camera = self._updates.T_map_track @ track.T_odom_camera
        return Step(
            keyframe=updates[-1].keyframe if updates else None,
            scene=newest.scene if newest else None,
            loops=tuple(loop for update in updates for loop in update.verified.admitted),
            candidates=tuple(c for update in updates for c in update.verified.candidates),
            T_map_odom=T_map_camera @ se3.inverse(tracked.T_odom_raw),
            is_lost=track.is_lost,
            open_axes=track.open_axes,
            T_map_camera=T_map_camera,
            covariance=self._updates.covariance(track),
        )

    def _begin_session(self) -> None:
        """Begin a session, within a call."""
        newest = self._updates.newest
        self._map.begin_session()
        self._frames.begin_session(newest.segment + 1 if newest else 0)

    @contextmanager
    def _call(self, *, wait: bool = False) -> Iterator[Checkpoint]:
        """Run a call alone, and whole or not at all; return the state before it.

        With ``wait`` all keyframes so far are in the map before it begins. A part of another call,
        such as the frame of a cloud, is as whole as that call.
        """
        if (before := self._calls.current) is not None:
            yield before
            return
        with self._calls.alone():
            self._mapping.send()
            if wait:
                self._mapping.drain()
            self._receive()
            with self._calls.whole(self._checkpoint()) as before:
                yield before
            self._mapping.send()
            self._save()

    def _checkpoint(self) -> Checkpoint:
        """Return the present state, but for that of mapping."""
        before = Checkpoint()
        before.save_attributes(self, "n_postponed")
        before.save(self._frames, self._updates)
        return before

    def _receive(self) -> None:
        """Take in the keyframes that were processed in the background since the last call."""
        finished = self._mapping.finished()
        if finished:
            newest = self._updates.newest
            with self._calls.whole(self._checkpoint()):
                for update in finished:
                    if newest is None or update.keyframe.id > newest.id:
                        self._apply(update)
            self._mapping.forget(len(finished))

    def _apply(self, update: MapUpdate) -> None:
        """Go on from a keyframe that is in the map."""
        self._updates.add(update, self.history.frames)
        if update.keyframe.session == self._frames.session:
            self._frames.tracker.trusts_odometry = update.trusts_odometry

    def _save(self) -> None:
        """Pass the records of new keyframes to the journal."""
        with self._clock.stage("save"):
            if self.journal is not None:
                self._updates.save(self.journal)
