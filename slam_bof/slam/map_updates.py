"""What came of the keyframes that a loop closer has given to the map."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from slam_bof.slam.map_uncertainty import PoseUncertainty
from slam_bof.slam.mapping import MapUpdate
from slam_bof.tracking import Track
from slam_bof.types import Array, FramePose, Keyframe, KeyframeRecord, Pose

__all__ = ["Journal", "MapUpdates"]

Journal = Callable[[KeyframeRecord], None]
"""Called with the record of each new keyframe to save it, such as ``MapWriter.write``. What it
raises ends the call of the loop closer, which has processed the frame all the same; the record
comes again before that of the next keyframe, and at the end."""


class MapUpdates:
    """Collects updates until a step returns them, and their records until a journal has them.

    Attributes
    ----------
    newest
        The newest keyframe in the map, None before the first.
    T_map_track
        (4, 4) correction of the track by the map; see ``MapUpdate``.
    uncertainty
        That of the newest keyframe, None before the first.
    """

    def __init__(self) -> None:
        self.newest: Keyframe | None = None
        self.T_map_track: Pose = np.eye(4)
        self.uncertainty: PoseUncertainty | None = None
        self._new: list[MapUpdate] = []
        self._unsaved: list[KeyframeRecord] = []

    def first_frame_after(self, session: int) -> int:
        """Return the index of a session's first frame after its newest keyframe in the map."""
        newest = self.newest
        return newest.frame_index + 1 if newest is not None and newest.session == session else 0

    def add(self, update: MapUpdate, frames: Sequence[FramePose]) -> None:
        """Add an update; ``frames`` are all frames of its keyframe's session."""
        keyframe, verified = update.keyframe, update.verified
        if update.depth is not None:
            first = self.first_frame_after(keyframe.session)
            record = KeyframeRecord(
                keyframe=keyframe,
                depth=update.depth,
                frames=tuple(frames[first : keyframe.frame_index + 1]),
                candidates=tuple(verified.candidates),
                measured=tuple(verified.measured),
                admitted=tuple(verified.admitted),
                culled=update.culled,
                state=update.state,
                constellation=update.constellation,
            )
            self._unsaved.append(record)
        self.newest, self.T_map_track = keyframe, update.T_map_track
        self.uncertainty = update.uncertainty
        self._new.append(update)

    def covariance(self, track: Track) -> Array | None:
        """Return the covariance (6, 6) of a frame in the map; None before there is a map."""
        known = self.uncertainty
        if known is None:
            return None
        is_tracked = not track.is_lost and track.segment == known.keyframe.segment
        return known.of_frame(track.T_odom_camera, track.open_axes if is_tracked else np.eye(6))

    def take(self) -> list[MapUpdate]:
        """Return the updates since the last call, oldest first."""
        taken, self._new = self._new, []
        return taken

    def save(self, journal: Journal) -> None:
        """Pass the records of new keyframes to a journal, oldest first."""
        while self._unsaved:
            journal(self._unsaved[0])
            del self._unsaved[0]
