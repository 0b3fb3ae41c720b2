"""A saved map read back as it was written, keyframe by keyframe."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import candidate_of, frame_of, keyframe_of, loop_of
from slam_bof.types import KeyframeRecord

__all__ = ["read_records"]


def read_records(store: MapStore, *, as_before: int | None = None) -> Iterator[KeyframeRecord]:
    """Return all that was written, keyframe by keyframe, to go on from there.

    Loops that the end of a session left out are not among those admitted; but for the end of
    the session ``as_before``, which is as if it had not come yet.

    Raises
    ------
    MapError
        If the map has no depth images, or one cannot be read.
    """
    states = {
        row["id"]: json.loads(row["state"] or "{}") for row in store.checked_rows("sessions", "")
    }
    starts: dict[int, int] = {}
    for row in store.checked_rows("keyframes", "ORDER BY id"):
        keyframe = keyframe_of(row, store.classes())
        frames = store.checked_rows(
            "frames",
            "WHERE session = ? AND frame_index BETWEEN ? AND ? ORDER BY frame_index",
            keyframe.session,
            starts.get(keyframe.session, 0),
            keyframe.frame_index,
        )
        views = store.checked_rows("views", "WHERE keyframe_id = ?", keyframe.id)
        if not frames or not views:
            raise MapError(
                f"{store.path}: found no {'frame' if views else 'depth image'} of keyframe "
                f"{keyframe.id}, expected one: maps made before version 4 have none"
            )
        poses = tuple(map(frame_of, frames))
        own = store.checked_rows("candidates", "WHERE query_id = ? ORDER BY id", keyframe.id)
        admitted = store.checked_rows(
            "candidates",
            "WHERE admitted_by = ? AND (left_out_by IS NULL OR left_out_by = ?) ORDER BY loop_id",
            keyframe.id,
            -1 if as_before is None else as_before,
        )
        starts[keyframe.session] = keyframe.frame_index + 1
        yield KeyframeRecord(
            replace(
                keyframe,
                T_odom_camera=poses[-1].T_odom_camera,
                step_covariance=poses[-1].covariance,
            ),
            store.thin(views[0]),
            poses,
            tuple(map(candidate_of, own)),
            tuple(loop_of(row) for row in own if row["information"] is not None),
            tuple(map(loop_of, admitted)),
            states[keyframe.session],
        )
