"""The data of a run's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import Candidate, Keyframe, Loop, Trajectory
from slam_bof.visualization.plan import Plan

__all__ = ["FrameHealth", "PicturedPair", "ReportData"]


class FrameHealth(NamedTuple):
    """How a frame was tracked: ``Step.health``, and the number of open directions.

    ``sigma_m`` and ``sigma_rad`` are the standard deviations of its position and direction by
    ``Step.covariance``, over all three axes; NaN where unknown.
    """

    health: str
    n_open: int
    sigma_m: float = float("nan")
    sigma_rad: float = float("nan")


class PicturedPair(NamedTuple):
    """A pair of keyframes that was considered as a loop, and their depth images side by side.

    ``depth_m`` is (H, 2 W), the query's to the left.
    """

    candidate: Candidate
    depth_m: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class ReportData:
    """The data of a report.

    Parameters
    ----------
    metrics
        As in metrics.json; None is shown as unknown.
    odometry, optimized
        ``T_odom_camera`` and ``T_map_camera`` of every frame.
    groundtruth
        ``T_world_camera``, associated with the frames by time stamp; NaN where unknown.
    keyframes, loops, candidates
        In order of time; a keyframe's ``frame_index`` is an index of the frames above.
    components
        The component of the map that each keyframe belongs to; empty if there is only one.
    true_scenes
        The true label of each keyframe, None where unknown.
    plans
        Plans of the largest components of the map that the session belongs to.
    health
        Of every frame; empty if it is not known.
    warnings
        What the run has warned of.
    pairs
        Some of the candidates, to be shown as pictures.
    command, configuration
        What makes the run again: a command line, and the configuration as YAML.
    """

    metrics: Mapping[str, str | int | float | None]
    odometry: Trajectory
    optimized: Trajectory
    groundtruth: Trajectory | None = None
    keyframes: Sequence[Keyframe] = ()
    loops: Sequence[Loop] = ()
    candidates: Sequence[Candidate] = ()
    true_scenes: Sequence[str | None] | None = None
    plans: Sequence[Plan] = ()
    components: Sequence[int] = ()
    health: Sequence[FrameHealth] = ()
    warnings: Sequence[str] = ()
    pairs: Sequence[PicturedPair] = ()
    command: str = ""
    configuration: str = ""

    def __post_init__(self) -> None:
        """Check the lengths."""
        if len(self.odometry) != len(self.optimized):
            raise ValueError(
                f"trajectories must have the same frames, got {len(self.odometry)} of odometry "
                f"and {len(self.optimized)} optimized"
            )
        if self.components and len(self.components) != len(self.keyframes):
            raise ValueError(
                f"components must have a number for each of {len(self.keyframes)} keyframes, "
                f"got {len(self.components)}"
            )
        if self.true_scenes is not None and len(self.true_scenes) != len(self.keyframes):
            raise ValueError(
                f"true_scenes must have a label for each of {len(self.keyframes)} keyframes, "
                f"got {len(self.true_scenes)}"
            )

    @property
    def frame_indices(self) -> list[int]:
        """The index of each keyframe's frame."""
        return [keyframe.frame_index for keyframe in self.keyframes]
