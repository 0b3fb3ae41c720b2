"""A complete small SLAM system: an odometry and a ``LoopCloser``, run over a data set."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import StageClock
from slam_bof.datasets import first_frame
from slam_bof.errors import DatasetError, FrameError
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.slam.loop_closer import LoopCloser
from slam_bof.slam.restored_odometry import (
    check_odometry,
    check_stamp,
    restore_odometry,
    state_of,
)
from slam_bof.types import (
    LOST,
    Array,
    Candidate,
    DepthFrame,
    FramePose,
    Keyframe,
    KeyframeRecord,
    Loop,
    OdometryState,
    Pose,
    Step,
    Trajectory,
)

__all__ = ["MiniSlam", "SlamResult", "of_session"]

Pair = TypeVar("Pair", Loop, Candidate)

SAVE_EVERY = 8
"""Number of keyframes from one saved state of the odometry to the next."""


@dataclass(frozen=True, slots=True, eq=False)
class SlamResult:
    """The result of a run: poses of all frames from odometry and from the map, and the loops.

    ``keyframes``, ``loops`` and ``loops_left_out`` are those of this session, with ids from 0.
    ``T_map_camera`` (K, 4, 4) are the poses of the keyframes.
    """

    odometry: Trajectory
    optimized: Trajectory
    indices: NDArray[np.int64]
    """(N,) indices of the frames in the data set; frames that could not be read are missing."""
    n_skipped: int
    n_resumed: int
    """Number of frames that were restored from an interrupted run."""
    n_repeated: int
    """Number of these that the odometry had to process again."""
    keyframes: list[Keyframe]
    T_map_camera: Array
    loops: list[Loop]
    loops_left_out: list[Loop]
    n_loops_across: int
    """Number of loops to earlier sessions."""


class MiniSlam:
    """Runs an odometry and a ``LoopCloser`` over a data set."""

    def __init__(
        self,
        odometry: Odometry,
        closer: LoopCloser,
        *,
        observer: Observer | None = None,
        clock: StageClock | None = None,
    ) -> None:
        self._odometry = odometry
        self._closer = closer
        self._observer = observer or NullObserver()
        self._clock = clock or StageClock()
        self._indices: list[int] = []
        """Indices of the frames of the data set so far; those that cannot be used are missing."""

    def run(
        self,
        dataset: Dataset,
        *,
        max_frames: int | None = None,
        odometry: OdometryState | None = None,
    ) -> SlamResult:
        """Process the sequence; a frame that cannot be read or used is skipped with a warning.

        Frames that the loop closer has restored from an interrupted run are processed by the
        odometry alone. Those up to a saved state of the odometry are not even read.

        Raises
        ------
        DatasetError
            If these frames or their odometry differ from those of the interrupted run.
        """
        n_frames = min(len(dataset), max_frames or len(dataset))
        self._observer.on_start(n_frames)
        restored, first = list(self._closer.history.frames), first_frame(dataset)
        self._indices = restore_odometry(self._odometry, odometry, dataset, restored)
        n_known = len(self._indices)
        poses = [frame.T_odom_raw for frame in restored[:n_known]]
        for index, before in zip(self._indices, restored, strict=False):
            self._observer.on_step(index, _step_of(before))
        start = self._indices[-1] + 1 if n_known else 0
        for index, frame in self._read(dataset, start, n_frames):
            with self._clock.stage("odometry"):
                T_odom_camera = self._odometry.process(frame)
            try:
                if len(poses) < len(restored):
                    before = restored[len(poses)]
                    check_stamp(dataset, index, frame, before)
                    check_odometry(dataset, index, T_odom_camera, before)
                    step = _step_of(before)
                else:
                    step = self._closer.process(frame, T_odom_camera)
            except FrameError as error:
                self._observer.on_warning(f"frame {first + index} skipped: {error}")
                continue
            self._indices.append(index)
            poses.append(T_odom_camera)
            self._observer.on_step(index, step)
        if len(poses) < len(restored):
            raise DatasetError(
                f"{dataset.sequence}: found {len(poses)} frames, expected at least the "
                f"{len(restored)} frames of the interrupted run"
            )
        return self._result(
            poses, n_frames=n_frames, n_resumed=len(restored), n_repeated=len(restored) - n_known
        )

    def odometry_state(self, record: KeyframeRecord) -> OdometryState | None:
        """Return the state of the odometry to be saved with a keyframe, None if none is to be.

        It is saved with some keyframes, if the odometry can save it and has not gone on since, as
        it has when keyframes are processed in the background.
        """
        keyframe = record.keyframe
        is_newest = keyframe.frame_index == len(self._indices)
        if keyframe.id % SAVE_EVERY or not is_newest:
            return None
        return state_of(self._odometry, self._indices)

    def _read(
        self, dataset: Dataset, start: int, n_frames: int
    ) -> Iterator[tuple[int, DepthFrame]]:
        """Yield the frames of a sequence from ``start`` on; skip those that cannot be read."""
        for index in range(start, n_frames):
            try:
                with self._clock.stage("read"):
                    frame = dataset.frame(index)
            except DatasetError as error:
                self._observer.on_warning(f"frame {first_frame(dataset) + index} skipped: {error}")
            else:
                yield index, frame.corrected(self._closer.config.sensor)

    def _result(
        self, poses: list[Pose], *, n_frames: int, n_resumed: int, n_repeated: int
    ) -> SlamResult:
        """Finish the loop closer and return the result of the session."""
        stamps_s = np.array([frame.stamp_s for frame in self._closer.history.frames])
        optimized = self._closer.finish()
        keyframes, first = self._closer.map, self._closer.map.first_keyframe
        ids = range(first, len(keyframes))
        T_map_camera = keyframes.poses() if len(keyframes) else np.empty((0, 4, 4))
        return SlamResult(
            odometry=Trajectory(stamps_s, np.array(poses).reshape(-1, 4, 4)),
            optimized=optimized,
            indices=np.array(self._indices, dtype=np.int64),
            n_skipped=n_frames - len(self._indices),
            n_resumed=n_resumed,
            n_repeated=n_repeated,
            keyframes=[replace(k, id=k.id - first) for k in keyframes.of_session],
            T_map_camera=T_map_camera[first:],
            loops=of_session(keyframes.loops, ids),
            loops_left_out=of_session(keyframes.loops_left_out, ids),
            n_loops_across=sum(loop.match_id < first <= loop.query_id for loop in keyframes.loops),
        )


def of_session(pairs: Iterable[Pair], ids: range) -> list[Pair]:
    """Return the pairs of keyframes within a session, with ids that count from 0."""
    return [
        replace(pair, query_id=pair.query_id - ids.start, match_id=pair.match_id - ids.start)
        for pair in pairs
        if pair.query_id in ids and pair.match_id in ids
    ]


def _step_of(frame: FramePose) -> Step:
    """Return the step of a restored frame."""
    return Step(None, None, (), (), np.eye(4), is_lost=frame.segment == LOST)
