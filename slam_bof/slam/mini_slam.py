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
from slam_bof.geometry import se3
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.slam.loop_closer import LoopCloser
from slam_bof.types import (
    Array,
    Candidate,
    DepthFrame,
    FramePose,
    Keyframe,
    Loop,
    Pose,
    Step,
    Trajectory,
)

__all__ = ["MiniSlam", "SlamResult", "of_session"]

Pair = TypeVar("Pair", Loop, Candidate)

MAX_ODOMETRY_DIFFERENCE = 1e-6
"""Largest difference of the odometry, in any entry of the pose, when a run is resumed."""


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

    def run(self, dataset: Dataset, *, max_frames: int | None = None) -> SlamResult:
        """Process the sequence; a frame that cannot be read or used is skipped with a warning.

        Frames that the loop closer has restored from an interrupted run are processed by the
        odometry alone.

        Raises
        ------
        DatasetError
            If these frames or their odometry differ from those of the interrupted run.
        """
        n_frames = min(len(dataset), max_frames or len(dataset))
        self._observer.on_start(n_frames)
        restored, first = list(self._closer.history.frames), first_frame(dataset)
        indices: list[int] = []
        poses: list[Pose] = []
        for index, frame in self._read(dataset, n_frames):
            with self._clock.stage("odometry"):
                T_odom_camera = self._odometry.process(frame)
            try:
                if len(poses) < len(restored):
                    before = restored[len(poses)]
                    _check_same(dataset, index, frame, T_odom_camera, before)
                    step = Step(None, None, (), (), np.eye(4), is_lost=before.segment < 0)
                else:
                    step = self._closer.process(frame, T_odom_camera)
            except FrameError as error:
                self._observer.on_warning(f"frame {first + index} skipped: {error}")
                continue
            indices.append(index)
            poses.append(T_odom_camera)
            self._observer.on_step(index, step)
        if len(poses) < len(restored):
            raise DatasetError(
                f"{dataset.sequence}: found {len(poses)} frames, expected at least the "
                f"{len(restored)} frames of the interrupted run"
            )
        return self._result(indices, poses, n_frames=n_frames, n_resumed=len(restored))

    def _read(self, dataset: Dataset, n_frames: int) -> Iterator[tuple[int, DepthFrame]]:
        """Yield the first frames of a sequence; skip those that cannot be read."""
        for index in range(n_frames):
            try:
                with self._clock.stage("read"):
                    frame = dataset.frame(index)
            except DatasetError as error:
                self._observer.on_warning(f"frame {first_frame(dataset) + index} skipped: {error}")
            else:
                yield index, frame.corrected(self._closer.sensor)

    def _result(
        self, indices: list[int], poses: list[Pose], *, n_frames: int, n_resumed: int
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
            indices=np.array(indices, dtype=np.int64),
            n_skipped=n_frames - len(indices),
            n_resumed=n_resumed,
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


def _check_same(
    dataset: Dataset, index: int, frame: DepthFrame, T_odom_camera: Pose, before: FramePose
) -> None:
    """Check that a frame and its odometry are the same as in the interrupted run."""
    where = f"{dataset.sequence}: frame {index}"
    if frame.stamp_s != before.stamp_s:
        raise DatasetError(
            f"{where}: found stamp {frame.stamp_s} s, expected {before.stamp_s} s as in the "
            "interrupted run: is this the same sequence?"
        )
    difference = float(np.abs(se3.inverse(before.T_odom_raw) @ T_odom_camera - np.eye(4)).max())
    if difference > MAX_ODOMETRY_DIFFERENCE:
        raise DatasetError(
            f"{where}: found an odometry pose that differs by {difference:.2g} (m, rad) from that "
            "of the interrupted run, expected the same: is this the same sequence, and is the "
            "odometry deterministic?"
        )
