"""The mini-SLAM: an odometry with the plug-in beside it, run over a data set."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import StageClock
from slam_bof.errors import DatasetError
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

SAME_M = 1e-6
"""An odometry that is run again over the same frames must not be farther off than this."""


@dataclass(frozen=True, slots=True, eq=False)
class SlamResult:
    """What a sequence came to: the poses of every frame read, before and after the map.

    ``keyframes``, ``loops`` and ``loops_left_out`` are those of this session, their ids from 0;
    ``T_map_camera`` (K, 4, 4) are the keyframes' poses.
    """

    odometry: Trajectory
    optimized: Trajectory
    indices: NDArray[np.int64]
    """(N,) which frames of the data set these are; those that could not be read are missing."""
    n_skipped: int
    n_resumed: int
    """Of how many frames all was known from an interrupted run."""
    keyframes: list[Keyframe]
    T_map_camera: Array
    loops: list[Loop]
    loops_left_out: list[Loop]
    n_loops_across: int
    """Loops to earlier sessions."""


class MiniSlam:
    """An odometry with a ``LoopCloser`` beside it, run over a data set."""

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
        """Process the sequence; a frame that cannot be read is skipped with a warning.

        Frames that the closer has restored are seen by the odometry alone, that it may go on.

        Raises
        ------
        DatasetError
            If those are not the frames that the closer has restored.
        """
        n_frames = min(len(dataset), max_frames or len(dataset))
        self._observer.on_start(n_frames)
        restored = list(self._closer.history.frames)
        indices: list[int] = []
        poses: list[Pose] = []
        for index in range(n_frames):
            try:
                with self._clock.stage("read"):
                    frame = dataset.frame(index)
            except DatasetError as error:
                self._observer.on_warning(f"frame {index} skipped: {error}")
                continue
            with self._clock.stage("odometry"):
                T_odom_camera = self._odometry.process(frame)
            indices.append(index)
            poses.append(T_odom_camera)
            if len(poses) <= len(restored):
                before = restored[len(poses) - 1]
                _check_same(dataset, index, frame, T_odom_camera, before)
                step = Step(None, None, (), (), np.eye(4), is_lost=before.segment < 0)
            else:
                step = self._closer.process(frame, T_odom_camera)
            self._observer.on_step(index, step)
        if len(poses) < len(restored):
            raise DatasetError(
                f"{dataset.sequence}: found {len(poses)} frames, expected the {len(restored)} of "
                "the interrupted run and those after them"
            )
        stamps_s = np.array([frame.stamp_s for frame in self._closer.history.frames])
        odometry = Trajectory(stamps_s, np.array(poses).reshape(-1, 4, 4))
        optimized = self._closer.finish()
        first = self._closer.map.first_keyframe
        ids = range(first, len(self._closer.map.keyframes))
        T_map_camera = (
            self._closer.map.backend.poses() if self._closer.map.keyframes else np.empty(0)
        )
        loops = self._closer.map.loops
        return SlamResult(
            odometry,
            optimized,
            np.array(indices, dtype=np.int64),
            n_frames - len(indices),
            len(restored),
            [replace(k, id=k.id - first) for k in self._closer.map.keyframes[first:]],
            np.reshape(T_map_camera, (-1, 4, 4))[first:],
            of_session(loops, ids),
            of_session(self._closer.map.loops_left_out, ids),
            sum(loop.match_id < first <= loop.query_id for loop in loops),
        )


def of_session(pairs: Iterable[Pair], ids: range) -> list[Pair]:
    """Return those between keyframes of a session, whose ids then count from 0."""
    return [
        replace(pair, query_id=pair.query_id - ids.start, match_id=pair.match_id - ids.start)
        for pair in pairs
        if pair.query_id in ids and pair.match_id in ids
    ]


def _check_same(
    dataset: Dataset, index: int, frame: DepthFrame, T_odom_camera: Pose, before: FramePose
) -> None:
    """Check that a frame is the one that was processed before the interruption."""
    where = f"{dataset.sequence}: frame {index}"
    if frame.stamp_s != before.stamp_s:
        raise DatasetError(
            f"{where}: found stamp {frame.stamp_s} s, expected {before.stamp_s} s as in the "
            "interrupted run: is this the same sequence?"
        )
    off_m = float(np.abs(se3.inverse(before.T_odom_raw) @ T_odom_camera - np.eye(4)).max())
    if off_m > SAME_M:
        raise DatasetError(
            f"{where}: found odometry {off_m:.2g} (m, rad) off that of the interrupted run, "
            "expected the same: is this the same sequence, and the odometry deterministic?"
        )
