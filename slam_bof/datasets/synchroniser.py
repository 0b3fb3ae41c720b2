"""Bring frames and poses together that come from different places, late or out of order.

>>> pairing = FramePoseSynchroniser()
>>> if not pairing.is_full:  # doctest: +SKIP
...     pairing.add_frame(frames.get())
>>> pairing.add_pose(stamp_s, T_odom_camera)  # doctest: +SKIP
>>> for frame, T in pairing.take():  # doctest: +SKIP
...     closer.process(frame, T)
"""

from __future__ import annotations

import bisect
import sys
from collections import Counter, deque
from dataclasses import dataclass
from numbers import Real
from typing import Any, Protocol

import numpy as np
from pydantic import Field

from slam_bof.geometry import se3
from slam_bof.types import Params, Pose

__all__ = ["Dropped", "FramePoseSynchroniser", "SynchroniserParams"]


class Stamped(Protocol):
    """A depth frame, or a point cloud or another thing with a time."""

    @property
    def stamp_s(self) -> float:
        """Time in seconds."""


class SynchroniserParams(Params):
    """Limits of what is kept, and how long a frame waits."""

    max_frames: int = Field(64, gt=0, description="Largest number of frames that wait for a pose.")
    max_poses: int = Field(1000, gt=1, description="Largest number of poses that are kept.")
    max_gap_s: float = Field(
        0.2, gt=0, description="Poses farther apart than this many seconds are not interpolated."
    )
    tolerance_s: float = Field(
        0.002,
        ge=0,
        description="A pose within this many seconds of a frame is used as it is, without "
        "interpolation.",
    )
    max_jump_s: float = Field(
        10.0,
        gt=0,
        description="A stamp that is more than this many seconds ahead of all others is ignored "
        "as broken until another one near it confirms it.",
    )
    max_wait_s: float = Field(
        1.0,
        gt=0,
        description="A frame without a pose is dropped when the newest pose is this many seconds "
        "newer.",
    )


@dataclass(frozen=True, slots=True)
class Dropped:
    """A frame that was not paired, or a pose that came too late for any frame, and the reason."""

    stamp_s: float
    reason: str


class FramePoseSynchroniser:
    """Holds frames until their poses are known; gives both out in the order of time.

    Memory is bounded: where ``is_full``, take from your queue of frames no more until poses have
    come; a frame added all the same is refused. Nothing is lost silently: each frame is given
    out once, or is in ``dropped`` with a reason, of which ``counts`` has the sum; so are poses
    that came too late to be of use.
    """

    def __init__(self, params: SynchroniserParams | None = None) -> None:
        self.params = params or SynchroniserParams()
        self.dropped: deque[Dropped] = deque(maxlen=1000)
        """The latest; ``counts`` goes on."""
        self.counts: Counter[str] = Counter()
        self._frames: list[Stamped] = []
        self._stamps_s: list[float] = []
        self._poses: list[Pose] = []
        self._last_s = -np.inf

    @property
    def is_full(self) -> bool:
        """Return whether no further frame is taken."""
        return len(self._frames) >= self.params.max_frames

    @property
    def n_waiting(self) -> int:
        """Return how many frames wait for their pose."""
        return len(self._frames)

    @property
    def waiting_stamps_s(self) -> list[float]:
        """Return the times of the frames that wait for their pose, oldest first."""
        return [frame.stamp_s for frame in self._frames]

    def add_frame(self, frame: Stamped) -> bool:
        """Add a frame, in any order; return whether it was accepted.

        One that is not newer than those given out already is dropped; one that there is no room
        for is refused, and still yours.

        Raises
        ------
        ValueError
            If its stamp is not finite.
        """
        _check_stamp("frame", frame.stamp_s)
        if self.is_full:
            return False
        stamps_s = [waiting.stamp_s for waiting in self._frames]
        at = bisect.bisect_left(stamps_s, frame.stamp_s)
        if frame.stamp_s <= self._last_s:
            self._drop(frame.stamp_s, "frame came after newer ones had been given out")
        elif at < len(stamps_s) and stamps_s[at] == frame.stamp_s:
            self._drop(frame.stamp_s, "frame came twice")
        else:
            self._frames.insert(at, frame)
        return True

    def add_pose(self, stamp_s: float, T_odom_camera: Pose) -> None:
        """Take a pose (4, 4), in any order.

        Raises
        ------
        ValueError
            If it is not finite or no rotation and translation, or its stamp is not finite.
        """
        _check_stamp("pose", stamp_s)
        T_odom_camera = se3.checked_pose(T_odom_camera)
        if stamp_s < self._last_s - self.params.max_gap_s:
            self._drop(stamp_s, "pose came after all frames that could need it")
            return
        at = bisect.bisect_left(self._stamps_s, stamp_s)
        if at < len(self._stamps_s) and self._stamps_s[at] == stamp_s:
            self._drop(stamp_s, "pose came twice")
            return
        if len(self._stamps_s) >= self.params.max_poses:
            if at == 0:
                self._drop(stamp_s, "pose older than all that there is room for")
                return
            self._drop(self._stamps_s.pop(0), "no room: too many poses for the frames waiting")
            self._poses.pop(0)
            at -= 1
        self._stamps_s.insert(at, float(stamp_s))
        self._poses.insert(at, T_odom_camera)

    def take(self, *, at_end: bool = False) -> list[tuple[Any, Pose]]:
        """Return the frames whose pose is known now, oldest first, and forget them.

        A frame waits for those before it, but for no longer than ``max_wait_s``; ``at_end``,
        when nothing more will come, no frame waits.
        """
        ready: list[tuple[Stamped, Pose]] = []
        newest_s = self._newest_s()
        while self._frames:
            frame = self._frames[0]
            if not at_end and frame.stamp_s > newest_s + self.params.max_jump_s:
                break  # the clock of a later frame, or a broken one
            T_odom_camera = self._pose_at(frame.stamp_s, at_end=at_end)
            if T_odom_camera is not None:
                ready.append((frame, T_odom_camera))
            elif at_end or newest_s > frame.stamp_s + self.params.max_wait_s:
                self._drop(frame.stamp_s, "frame's pose did not come")
            else:
                break
            self._frames.pop(0)
            self._last_s = frame.stamp_s
        self._forget()
        return ready

    def _newest_s(self) -> float:
        """Return the newest stamp that the one before it confirms; else the oldest, if any."""
        stamps_s = self._stamps_s
        for k in range(len(stamps_s) - 1, 0, -1):
            if stamps_s[k] - stamps_s[k - 1] <= self.params.max_jump_s:
                return stamps_s[k]
        return stamps_s[0] if stamps_s else -np.inf

    def _pose_at(self, stamp_s: float, *, at_end: bool) -> Pose | None:
        """Return the pose at a time: its own, or of those around it."""
        p = self.params
        after = bisect.bisect_left(self._stamps_s, stamp_s)
        near = [k for k in (after - 1, after) if 0 <= k < len(self._stamps_s)]
        for k in sorted(near, key=lambda k: abs(self._stamps_s[k] - stamp_s)):
            if abs(self._stamps_s[k] - stamp_s) <= p.tolerance_s:
                return self._poses[k]
        if len(near) < 2:
            return None
        before_s, after_s = self._stamps_s[after - 1], self._stamps_s[after]
        # A pose of its own may still come, late.
        settled = at_end or self._newest_s() > stamp_s + 0.5 * p.max_wait_s
        if after_s - before_s > p.max_gap_s or not settled:
            return None
        fraction = (stamp_s - before_s) / (after_s - before_s)
        return se3.interpolate(self._poses[after - 1], self._poses[after], fraction)

    def _forget(self) -> None:
        """Forget poses that no frame, waiting or to come, can need."""
        n_old = bisect.bisect_left(self._stamps_s, self._last_s - self.params.max_gap_s)
        del self._stamps_s[:n_old], self._poses[:n_old]

    def _drop(self, stamp_s: float, reason: str) -> None:
        self.dropped.append(Dropped(stamp_s, reason))
        self.counts[reason] += 1


def _check_stamp(what: str, stamp_s: float) -> None:
    is_number = isinstance(stamp_s, Real) and not isinstance(stamp_s, bool)
    if not is_number or not abs(stamp_s) <= sys.float_info.max:
        raise ValueError(f"a {what}'s stamp must be finite, got {stamp_s!r:.40}")
