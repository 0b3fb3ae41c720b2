"""The mini-SLAM: an odometry with the plug-in beside it, run over a data set."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import DatasetError
from slam_bof.ports import Dataset, NullObserver, Observer, Odometry
from slam_bof.slam import LoopCloser
from slam_bof.timing import StageClock
from slam_bof.types import Pose, Trajectory

__all__ = ["MiniSlam", "SlamResult"]


@dataclass(frozen=True, slots=True, eq=False)
class SlamResult:
    """What a sequence came to: the poses of every frame read, before and after the map."""

    odometry: Trajectory
    optimized: Trajectory
    indices: NDArray[np.int64]
    """(N,) which frames of the data set these are; those that could not be read are missing."""
    n_skipped: int


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
        """Process the sequence; a frame that cannot be read is skipped with a warning."""
        n_frames = min(len(dataset), max_frames or len(dataset))
        self._observer.on_start(n_frames)
        indices: list[int] = []
        stamps_s: list[float] = []
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
            stamps_s.append(frame.stamp_s)
            poses.append(T_odom_camera)
            step = self._closer.process(frame, T_odom_camera)
            self._observer.on_step(index, step)
        odometry = Trajectory(np.array(stamps_s), np.array(poses).reshape(-1, 4, 4))
        return SlamResult(
            odometry,
            self._closer.finish(),
            np.array(indices, dtype=np.int64),
            n_frames - len(indices),
        )
