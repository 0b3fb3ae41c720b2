"""The record of a run that its metrics, files and report are made from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from slam_bof.core import StageClock, Usage
from slam_bof.ports import Dataset
from slam_bof.run.options import RunOptions
from slam_bof.slam import LoopCloser, SlamResult
from slam_bof.types import Candidate, Scene, Trajectory
from slam_bof.visualization import FrameHealth

__all__ = ["RunRecord"]


@dataclass(frozen=True, slots=True, eq=False)
class RunRecord:
    """A session that has been run to its end.

    Parameters
    ----------
    dataset, closer, seed
        The sequence, the plug-in that has processed it, and the seed of the run.
    result
        The trajectories, keyframes and loops.
    candidates
        The audit trail; ids of keyframes count from 0, as in ``result``.
    smoothed, n_rooms
        The label of each keyframe that also uses the keyframes around it, and the number of rooms
        in the map.
    groundtruth, true_scenes
        The true pose of each frame of the sequence, and the true label of each keyframe; None
        where the data set has none.
    groundtruth_offset_s
        Time that was added to the time stamps of the true poses, None without true poses.
    options
        How far the run goes, and how it writes ``map.ply``.
    live
        The pose of each frame in the map as it was known at the time; None for a resumed run.
    health
        How each frame of ``result`` was tracked.
    usage, clock
        Time spent in this process.
    """

    dataset: Dataset
    closer: LoopCloser
    seed: int
    result: SlamResult
    candidates: Sequence[Candidate]
    smoothed: Sequence[Scene | None]
    n_rooms: int
    groundtruth: Trajectory | None
    groundtruth_offset_s: float | None
    true_scenes: Sequence[str] | None
    options: RunOptions
    live: Trajectory | None
    health: Sequence[FrameHealth]
    usage: Usage
    clock: StageClock
