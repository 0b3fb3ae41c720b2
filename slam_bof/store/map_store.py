"""The map on disk: ``map.db`` (see ``schema`` for its tables), written keyframe by keyframe.

Each keyframe is committed in one transaction with its candidates and loops (write-ahead logging),
so a killed run loses at most the keyframe being written. A closed map is a single file.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from slam_bof.scenes import MapRoom
from slam_bof.store.map_reader import MapReader, Session
from slam_bof.store.row_codec import (
    INSERT_CANDIDATE,
    INSERT_CONSTELLATION,
    INSERT_FRAME,
    INSERT_KEYFRAME,
    INSERT_ODOMETRY,
    INSERT_REGION,
    INSERT_VIEW,
    encode_candidate,
    encode_constellation,
    encode_edge,
    encode_frame,
    encode_keyframe,
    encode_odometry,
    encode_pose,
    encode_room,
    encode_scene,
    encode_view,
)
from slam_bof.store.schema import POSE_COLUMNS, SMOOTHED_COLUMNS
from slam_bof.store.sqlite import update_checksums
from slam_bof.types import (
    Array,
    CandidateSource,
    FramePose,
    KeyframeRecord,
    Loop,
    OdometryState,
    Scene,
)

__all__ = ["MapStore", "SessionResult"]


@dataclass(frozen=True, slots=True, eq=False)
class SessionResult:
    """The result for the whole map when a session is finished.

    ``frames`` are those after the newest keyframe. ``T_map_camera`` (K, 4, 4) are the optimised
    poses of all keyframes in the order of their ids, ``smoothed`` (K,) their smoothed labels, and
    ``rooms`` the rooms. ``left_out`` are the loops that the final optimisation left out, and
    ``reason`` says why, for the audit trail.
    """

    frames: Sequence[FramePose]
    T_map_camera: Array
    smoothed: Sequence[Scene | None]
    rooms: Sequence[MapRoom]
    left_out: Iterable[Loop] = ()
    reason: str = ""


class MapStore(MapReader):
    """A map.db to read and to write: keyframes, frames, loops, candidates, rooms, parameters.

    Examples
    --------
    >>> with MapStore.open("map.db") as store:  # doctest: +SKIP
    ...     keyframes, T_map_camera = store.keyframes(), store.map_poses()
    """

    def begin_session(self, session: Session) -> None:
        """Save the session that the next keyframes belong to; ``ValueError`` if its id is taken."""
        row = asdict(session)
        names = ", ".join(row)
        with self.transaction() as db:
            db.execute(
                f"INSERT INTO sessions ({names}) VALUES ({', '.join('?' * len(row))})",
                tuple(row.values()),
            )
            update_checksums(db, "sessions", "id = ?", session.id)

    def write(self, record: KeyframeRecord, odometry: OdometryState | None = None) -> None:
        """Save a keyframe's record in one transaction: all of it or, on an error, nothing.

        ``odometry`` replaces the saved state of the odometry; without it, that of an earlier
        keyframe stays.

        Raises
        ------
        ValueError
            If the keyframe's id is taken, a candidate refers to a missing keyframe, an admitted
            loop is not a candidate, or the camera or scene classes differ from those of earlier
            keyframes.
        """
        keyframe = record.keyframe
        first = keyframe.frame_index - len(record.frames) + 1
        with self.transaction() as db:
            if keyframe.scene is not None:
                self._keep_constant(db, "classes", list(keyframe.scene.classes))
            self._keep_constant(db, "camera", asdict(record.depth.intrinsics))
            db.execute(INSERT_KEYFRAME, encode_keyframe(keyframe))
            update_checksums(db, "keyframes", "id = ?", keyframe.id)
            db.execute(INSERT_VIEW, encode_view(keyframe.id, record.depth))
            update_checksums(db, "views", "keyframe_id = ?", keyframe.id)
            if record.constellation is not None:
                values = encode_constellation(keyframe.id, record.constellation)
                db.execute(INSERT_CONSTELLATION, values)
                update_checksums(db, "constellations", "keyframe_id = ?", keyframe.id)
            self._add_frames(db, keyframe.session, first, record.frames)
            self._add_candidates(db, record)
            db.executemany(
                "INSERT INTO culled (keyframe_id, anchor_id, culled_by) VALUES (?, ?, ?)",
                [(*pair, int(keyframe.id)) for pair in record.culled],
            )
            update_checksums(db, "culled", "culled_by = ?", keyframe.id)
            db.execute(
                "UPDATE sessions SET state = ? WHERE id = ?",
                (json.dumps(record.state), keyframe.session),
            )
            update_checksums(db, "sessions", "id = ?", keyframe.session)
            if odometry is not None:
                db.execute("DELETE FROM odometry")
                db.executemany(INSERT_ODOMETRY, encode_odometry(keyframe.session, odometry))
                update_checksums(db, "odometry")

    def finish(self, session_id: int, result: SessionResult) -> None:
        """Save the result of a session for the whole map, in one transaction."""
        ids = [row["id"] for row in self.select("SELECT id FROM keyframes ORDER BY id")]
        n = len(ids)
        if np.shape(result.T_map_camera) != (n, 4, 4):
            raise ValueError(f"poses must be ({n}, 4, 4), got {np.shape(result.T_map_camera)}")
        if len(result.smoothed) != n:
            raise ValueError(f"smoothed must have {n} labels, got {len(result.smoothed)}")
        ((n_frames,),) = self.select(
            "SELECT count(*) FROM frames JOIN (SELECT coalesce(max(frame_index), -1) AS last"
            " FROM keyframes WHERE session = ?) WHERE session = ? AND frame_index <= last",
            session_id,
            session_id,
        )
        room_by_id = {id_: room.id for room in result.rooms for id_ in room.keyframe_ids}
        names = [*(f"map_{name}" for name in POSE_COLUMNS), *SMOOTHED_COLUMNS]
        rows = [
            (*encode_pose(T), *encode_scene(scene), room_by_id.get(id_), id_)
            for T, scene, id_ in zip(result.T_map_camera, result.smoothed, ids, strict=True)
        ]
        with self.transaction() as db:
            db.executemany(
                f"UPDATE keyframes SET {', '.join(f'{name} = ?' for name in names)} WHERE id = ?",
                rows,
            )
            update_checksums(db, "keyframes")
            db.execute("DELETE FROM regions")
            db.executemany(INSERT_REGION, map(encode_room, result.rooms))
            update_checksums(db, "regions")
            db.execute(
                "UPDATE candidates SET decision = 'accepted', reason = '', left_out_by = NULL"
                " WHERE left_out_by = ?",
                (session_id,),
            )
            db.executemany(
                "UPDATE candidates SET decision = 'rejected', reason = ?, left_out_by = ?"
                " WHERE query_id = ? AND match_id = ? AND source = ? AND loop_id IS NOT NULL",
                [(result.reason, session_id, *_key_of(loop)) for loop in result.left_out],
            )
            update_checksums(db, "candidates", "loop_id IS NOT NULL")
            db.execute(
                "DELETE FROM frames WHERE session = ? AND frame_index >= ?", (session_id, n_frames)
            )
            self._add_frames(db, session_id, n_frames, result.frames)
            db.execute("UPDATE sessions SET is_finished = 1 WHERE id = ?", (session_id,))
            update_checksums(db, "sessions", "id = ?", session_id)

    def set_parameters(self, parameters: Mapping[str, object]) -> None:
        """Save parameters of the whole map; values that are not strings are saved as JSON."""
        with self.transaction() as db:
            for key, value in parameters.items():
                _set(db, key, value)

    def _add_frames(
        self, db: sqlite3.Connection, session: int, first: int, frames: Iterable[FramePose]
    ) -> None:
        rows = [encode_frame(session, first + k, frame) for k, frame in enumerate(frames)]
        db.executemany(INSERT_FRAME, rows)
        update_checksums(db, "frames", "session = ? AND frame_index >= ?", session, first)

    def _add_candidates(self, db: sqlite3.Connection, record: KeyframeRecord) -> None:
        """Add a keyframe's candidates, and mark earlier ones that were held and are now loops."""
        id_ = int(record.keyframe.id)
        ((next_id,),) = db.execute("SELECT coalesce(max(loop_id) + 1, 0) FROM candidates")
        order = {_key_of(loop): next_id + k for k, loop in enumerate(record.admitted)}
        measured = {_key_of(loop): loop for loop in record.measured}
        for candidate in record.candidates:
            pair = (candidate.query_id, candidate.match_id, candidate.source)
            loop_id = order.pop(pair, None)
            by = None if loop_id is None else id_
            edge = encode_edge(measured.get(pair), loop_id=loop_id, admitted_by=by)
            db.execute(INSERT_CANDIDATE, encode_candidate(candidate, edge))
        # A loop that was held until others agreed is a candidate of an earlier keyframe.
        for pair, loop_id in order.items():
            found = db.execute(
                "UPDATE candidates SET decision = 'accepted', reason = '', loop_id = ?,"
                " admitted_by = ? WHERE query_id = ? AND match_id = ? AND source = ?"
                " AND loop_id IS NULL",
                (loop_id, id_, *pair),
            )
            if found.rowcount != 1:
                raise ValueError(f"{self.path}: loop {pair} is not a candidate of the map")
        update_checksums(db, "candidates", "query_id = ? OR admitted_by = ?", id_, id_)

    def _keep_constant(self, db: sqlite3.Connection, key: str, value: object) -> None:
        """Save a parameter that all keyframes share; ``ValueError`` if its value differs."""
        row = db.execute("SELECT value FROM parameters WHERE key = ?", (key,)).fetchone()
        if row is None:
            _set(db, key, json.dumps(value))
        elif json.loads(row["value"]) != value:
            raise ValueError(f"{self.path}: {key} must stay {row['value']}, got {value}")


def _key_of(loop: Loop) -> tuple[int, int, CandidateSource]:
    """Return the key that a loop and its candidate share."""
    return int(loop.query_id), int(loop.match_id), loop.source


def _set(db: sqlite3.Connection, key: str, value: object) -> None:
    text = value if isinstance(value, str) else json.dumps(value)
    db.execute("REPLACE INTO parameters (key, value) VALUES (?, ?)", (key, text))
    update_checksums(db, "parameters", "key = ?", key)
