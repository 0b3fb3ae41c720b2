"""Replay of a saved map: the records that were written, keyframe by keyframe."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import decode_candidate, decode_frame, decode_loop
from slam_bof.types import KeyframeRecord

__all__ = ["replay_keyframes"]


def replay_keyframes(
    store: MapStore, *, reopened_session: int | None = None
) -> Iterator[KeyframeRecord]:
    """Yield the records of a map in the order they were written, to continue the map from there.

    Parameters
    ----------
    store
        The map.
    reopened_session
        Id of a session that is replayed as if it had not been finished: loops that its final
        optimisation left out are among the admitted loops again. Those that other sessions left
        out are not.

    Raises
    ------
    MapError
        If the map has no depth images, or a row is damaged.
    """
    states = {row["id"]: json.loads(row["state"] or "{}") for row in store.rows("sessions", "")}
    starts: dict[int, int] = {}
    gone: set[int] = set()
    for row in store.keyframe_rows():
        keyframe = store.decode(row)
        start = starts.get(keyframe.session, 0)
        frames = store.rows(
            "frames",
            "WHERE session = ? AND frame_index BETWEEN ? AND ? ORDER BY frame_index",
            keyframe.session,
            start,
            keyframe.frame_index,
        )
        views = store.rows("views", "WHERE keyframe_id = ?", keyframe.id)
        is_whole = len(frames) == keyframe.frame_index + 1 - start
        if not is_whole or not views:
            raise MapError(
                f"{store.path}: found no {'frame' if views else 'depth image'} of keyframe "
                f"{keyframe.id}, expected one: maps made before version 4 have none"
            )
        poses = tuple(map(decode_frame, frames))
        own = store.candidate_rows("WHERE query_id = ? ORDER BY id", keyframe.id)
        admitted = store.candidate_rows(
            "WHERE admitted_by = ? AND (left_out_by IS NULL OR left_out_by = ?) ORDER BY loop_id",
            keyframe.id,
            -1 if reopened_session is None else reopened_session,
        )
        starts[keyframe.session] = keyframe.frame_index + 1
        yield KeyframeRecord(
            keyframe=replace(
                keyframe,
                T_odom_camera=poses[-1].T_odom_camera,
                T_odom_raw=poses[-1].T_odom_raw,
                step_covariance=poses[-1].step_covariance,
            ),
            depth=store.depth_of(views[0]),
            frames=poses,
            candidates=tuple(map(decode_candidate, own)),
            measured=tuple(decode_loop(row) for row in own if row["information"] is not None),
            admitted=tuple(map(decode_loop, admitted)),
            culled=_culled_by(store, keyframe.id, gone),
            state=states[keyframe.session],
            constellation=store.constellation(keyframe.id),
        )


def _culled_by(store: MapStore, keyframe_id: int, gone: set[int]) -> tuple[tuple[int, int], ...]:
    """Return the keyframes that were culled with one, and their anchors; add them to ``gone``."""
    rows = store.rows("culled", "WHERE culled_by = ? ORDER BY keyframe_id", keyframe_id)
    culled = tuple((row["keyframe_id"], row["anchor_id"]) for row in rows)
    gone |= dict(culled).keys()
    if wrong := [pair for pair in culled if pair[1] in gone]:
        raise MapError(
            f"{store.path}: found keyframe {wrong[0][1]}, which was culled, as the anchor of "
            f"keyframe {wrong[0][0]}, expected one in use"
        )
    return culled
