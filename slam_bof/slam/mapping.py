"""The way of a tracked frame into the map, where it becomes a keyframe with loops."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any, Protocol

from slam_bof.core import Checkpoint, StageClock
from slam_bof.geometry import subsample
from slam_bof.loops import Verified
from slam_bof.slam.config import Config
from slam_bof.slam.keyframe_map import KeyframeMap
from slam_bof.slam.map_uncertainty import PoseUncertainty
from slam_bof.slam.session_frames import TrackedFrame
from slam_bof.types import Keyframe, Pose, SavedConstellation, SubsampledDepth

__all__ = ["DirectMapping", "KeyframeJob", "MapUpdate", "Mapping", "map_keyframe"]


@dataclass(frozen=True, slots=True, eq=False)
class KeyframeJob:
    """A frame that becomes a keyframe.

    ``state`` is the state of tracking as JSON values for the journal, None without one.
    """

    tracked: TrackedFrame
    state: dict[str, Any] | None


@dataclass(frozen=True, slots=True, eq=False)
class MapUpdate:
    """A keyframe that has come into the map, and the keyframes that were culled with it.

    ``T_map_track`` is the correction of its track by the map, and ``trusts_odometry`` says whether
    the map has found odometry to be about as precise as alignment. ``uncertainty`` is that of the
    keyframe's pose. ``depth``, ``constellation`` and ``state``, of tracking and of the map, are for
    the journal.
    """

    keyframe: Keyframe
    verified: Verified
    culled: tuple[tuple[int, int], ...]
    T_map_track: Pose
    trusts_odometry: bool
    uncertainty: PoseUncertainty
    depth: SubsampledDepth | None
    constellation: SavedConstellation | None
    state: dict[str, Any]


def map_keyframe(map_: KeyframeMap, job: KeyframeJob) -> MapUpdate:
    """Describe and label a keyframe, find and verify its loops, and optimise the pose graph."""
    tracked, track = job.tracked, job.tracked.track
    keyframe = map_.describe(
        tracked.index,
        tracked.frame,
        track.T_odom_camera,
        segment=track.segment,
        step_covariance=track.step_covariance,
        T_odom_raw=tracked.T_odom_raw,
    )
    verified = map_.add(keyframe, tracked.frame)
    culled = map_.cull()
    is_saved = job.state is not None
    return MapUpdate(
        keyframe=keyframe,
        verified=verified,
        culled=culled,
        T_map_track=map_.T_map_track,
        trusts_odometry=map_.trusts_odometry,
        uncertainty=map_.uncertainty(),
        depth=subsample(tracked.frame) if is_saved else None,
        constellation=map_.newest_constellation if is_saved else None,
        state={} if job.state is None else {**job.state, "detector": map_.state()},
    )


class Mapping(Protocol):
    """Takes frames that become keyframes, and returns what came of them, now or later."""

    @property
    def map(self) -> KeyframeMap:
        """The map with all keyframes so far."""

    @property
    def n_waiting(self) -> int:
        """Number of keyframes that are not in the map yet."""

    @property
    def is_full(self) -> bool:
        """Whether no frame can become a keyframe now, because too many wait."""

    def submit(self, job: KeyframeJob) -> MapUpdate | None:
        """Take a frame; return what came of it, or None if that comes later."""

    def send(self) -> None:
        """Hand on the submitted frames, once the call that they came with has succeeded."""

    def finished(self) -> list[MapUpdate]:
        """Return the keyframes that came later, oldest first, until ``forget``.

        Raises
        ------
        Exception
            If a keyframe could not be processed. It is not in the map.
        """

    def forget(self, n: int) -> None:
        """Forget the first ``n`` of ``finished``."""

    def drain(self) -> None:
        """Wait until no keyframe waits."""

    def close(self) -> Any:
        """End what runs beside the caller."""

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the present state; see ``core.Checkpoint``."""


class DirectMapping:
    """Processes each keyframe at once, in the thread of the caller."""

    n_waiting = 0
    is_full = False

    def __init__(self, config: Config, clock: StageClock) -> None:
        self.map = KeyframeMap(config, clock)
        self.submit = partial(map_keyframe, self.map)

    def send(self) -> None:
        """Do nothing: ``submit`` does it all."""

    def finished(self) -> list[MapUpdate]:
        """Return nothing."""
        return []

    def forget(self, n: int) -> None:
        """Do nothing."""

    def drain(self) -> None:
        """Do nothing: no keyframe waits."""

    def close(self) -> None:
        """Do nothing: nothing runs beside the caller."""

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the map."""
        before = Checkpoint()
        before.save(self.map)
        return before.restore
