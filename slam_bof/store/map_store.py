"""The map on disk: ``map.db`` (see ``schema`` for its tables), written keyframe by keyframe.

Each keyframe is committed with all that was learnt with it as it comes (write-ahead logging), so
a killed run loses at most the keyframe in hand. When the writer closes, all is in one file.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from slam_bof.errors import MapError
from slam_bof.geometry import thicken
from slam_bof.scenes import Region
from slam_bof.store.database import MapFile
from slam_bof.store.row_codec import (
    INSERT_CANDIDATE,
    INSERT_FRAME,
    INSERT_KEYFRAME,
    INSERT_REGION,
    INSERT_VIEW,
    candidate_of,
    candidate_row,
    edge_row,
    frame_of,
    frame_row,
    keyframe_of,
    keyframe_row,
    loop_of,
    pose_of,
    pose_row,
    region_of,
    region_row,
    scene_row,
    thin_of,
    view_row,
)
from slam_bof.store.schema import CHECKED, POSE, SMOOTHED
from slam_bof.store.sqlite import row_crc, sign
from slam_bof.types import (
    Array,
    Candidate,
    DepthFrame,
    FramePose,
    Intrinsics,
    Keyframe,
    KeyframeRecord,
    Loop,
    Scene,
    ThinDepth,
)

__all__ = ["MapStore", "Session", "SessionResult"]


@dataclass(frozen=True, slots=True)
class Session:
    """A run that the map is of; ``config`` is YAML, ``max_frames`` None if it is of all frames."""

    id: int
    dataset: str
    sequence: str
    config: str = ""
    seed: int = 0
    version: str = ""
    max_frames: int | None = None
    is_finished: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class SessionResult:
    """What the end of a session says of the whole map.

    ``frames`` are those after the newest keyframe; ``T_map_camera`` (K, 4, 4) the optimised
    poses of all keyframes, in the order of their ids, ``smoothed`` (K,) their labels, and
    ``regions`` the rooms. ``left_out`` are the loops that contradict the rest, for the ``reason``.
    """

    frames: Sequence[FramePose]
    T_map_camera: Array
    smoothed: Sequence[Scene | None]
    regions: Sequence[Region]
    left_out: Iterable[Loop] = ()
    reason: str = ""


class MapStore(MapFile):
    """What is in a map.db.

    Examples
    --------
    >>> with MapStore.open("map.db") as store:  # doctest: +SKIP
    ...     keyframes, T_map_camera = store.keyframes(), store.map_poses()
    """

    _classes: tuple[str, ...] | None = None

    def begin_session(self, session: Session) -> None:
        """Save what the next keyframes come from; ``ValueError`` if its id is not the next."""
        row = asdict(session)
        names = ", ".join(row)
        with self.transaction() as db:
            db.execute(
                f"INSERT INTO sessions ({names}) VALUES ({', '.join('?' * len(row))})",
                tuple(row.values()),
            )
            sign(db, "sessions", "id = ?", session.id)

    def write(self, record: KeyframeRecord) -> None:
        """Save a keyframe and what was learnt with it: all of it or, on an error, nothing.

        Raises
        ------
        ValueError
            If the keyframe's id is taken, a candidate names a keyframe that is not there, a
            loop is no candidate, or camera or scene classes are not those of the keyframes before.
        """
        keyframe = record.keyframe
        first = keyframe.frame_index - len(record.frames) + 1
        with self.transaction() as db:
            if keyframe.scene is not None:
                self._keep(db, "classes", list(keyframe.scene.classes))
            self._keep(db, "camera", asdict(record.thin.intrinsics))
            db.execute(INSERT_KEYFRAME, keyframe_row(keyframe))
            sign(db, "keyframes", "id = ?", keyframe.id)
            db.execute(INSERT_VIEW, view_row(keyframe.id, record.thin))
            sign(db, "views", "keyframe_id = ?", keyframe.id)
            self._add_frames(db, keyframe.session, first, record.frames)
            self._add_candidates(db, record)
            db.execute(
                "UPDATE sessions SET state = ? WHERE id = ?",
                (json.dumps(record.state), keyframe.session),
            )
            sign(db, "sessions", "id = ?", keyframe.session)

    def finish(self, session_id: int, result: SessionResult) -> None:
        """Save what the end of a session says of the whole map, in one transaction."""
        ids = [row["id"] for row in self.select("SELECT id FROM keyframes ORDER BY id")]
        n = len(ids)
        if np.shape(result.T_map_camera) != (n, 4, 4):
            raise ValueError(f"poses must be ({n}, 4, 4), got {np.shape(result.T_map_camera)}")
        if len(result.smoothed) != n:
            raise ValueError(f"smoothed must have {n} labels, got {len(result.smoothed)}")
        ((n_frames,),) = self.select(
            "SELECT count(*) FROM frames JOIN (SELECT coalesce(max(frame_index), -1) AS last"
            " FROM keyframes WHERE session = ?1) WHERE session = ?1 AND frame_index <= last",
            session_id,
        )
        region_by_id = {id_: region.id for region in result.regions for id_ in region.keyframe_ids}
        names = [*(f"map_{name}" for name in POSE), *SMOOTHED]
        rows = [
            (*pose_row(T), *scene_row(scene), region_by_id.get(id_), id_)
            for T, scene, id_ in zip(result.T_map_camera, result.smoothed, ids, strict=True)
        ]
        with self.transaction() as db:
            db.executemany(
                f"UPDATE keyframes SET {', '.join(f'{name} = ?' for name in names)} WHERE id = ?",
                rows,
            )
            sign(db, "keyframes")
            db.execute("DELETE FROM regions")
            db.executemany(INSERT_REGION, map(region_row, result.regions))
            sign(db, "regions")
            db.execute(
                "UPDATE candidates SET decision = 'accepted', reason = '', left_out_by = NULL"
                " WHERE left_out_by = ?",
                (session_id,),
            )
            db.executemany(
                "UPDATE candidates SET decision = 'rejected', reason = ?, left_out_by = ?"
                " WHERE query_id = ? AND match_id = ? AND source = ? AND loop_id IS NOT NULL",
                [(result.reason, session_id, *_pair(loop)) for loop in result.left_out],
            )
            sign(db, "candidates", "loop_id IS NOT NULL")
            db.execute(
                "DELETE FROM frames WHERE session = ? AND frame_index >= ?", (session_id, n_frames)
            )
            self._add_frames(db, session_id, n_frames, result.frames)
            db.execute("UPDATE sessions SET is_finished = 1 WHERE id = ?", (session_id,))
            sign(db, "sessions", "id = ?", session_id)

    def set_parameters(self, parameters: Mapping[str, object]) -> None:
        """Save what holds for the whole map; values that are no strings are kept as JSON."""
        with self.transaction() as db:
            for key, value in parameters.items():
                _set(db, key, value)

    def parameters(self) -> dict[str, str]:
        """Return what holds for the whole map."""
        rows = self.select("SELECT key, value FROM parameters ORDER BY key")
        return {row["key"]: row["value"] for row in rows}

    def classes(self) -> tuple[str, ...]:
        """Return the scene labels in the order of the probabilities; () without labels."""
        if not self._classes:
            self._classes = tuple(json.loads(self.parameters().get("classes", "[]")))
        return self._classes

    def intrinsics(self) -> Intrinsics | None:
        """Return the depth camera, of the whole image, that the map was made with, if known."""
        camera = self.parameters().get("camera")
        return None if camera is None else Intrinsics(**json.loads(camera))

    def sessions(self) -> list[Session]:
        """Return the runs that the map is of, in the order they came."""
        names = [field.name for field in fields(Session)]
        rows = self.select(f"SELECT {', '.join(names)} FROM sessions ORDER BY id")
        return [
            Session(**{**dict(zip(names, row, strict=True)), "is_finished": bool(row[-1])})
            for row in rows
        ]

    def frames(self, session_id: int) -> list[FramePose]:
        """Return a session's frames up to its newest keyframe, all of them if it is finished."""
        rows = self.select(
            "SELECT * FROM frames WHERE session = ? ORDER BY frame_index", session_id
        )
        return [frame_of(row) for row in rows]

    def keyframes(self) -> list[Keyframe]:
        """Return all keyframes, in the order of their ids."""
        rows = self.select("SELECT * FROM keyframes ORDER BY id")
        return [keyframe_of(row, self.classes()) for row in rows]

    def map_poses(self) -> Array:
        """Return T_map_camera of all keyframes, (K, 4, 4), NaN where there is none yet."""
        rows = self.select("SELECT * FROM keyframes ORDER BY id")
        poses = np.full((len(rows), 4, 4), np.nan)
        for i, row in enumerate(rows):
            if row["map_tx"] is not None:
                poses[i] = pose_of(row, "map_")
        return poses

    def regions(self) -> list[Region]:
        """Return the rooms of the map; none until a session is finished."""
        inside: dict[int, list[int]] = {}
        for row in self.select("SELECT id, region FROM keyframes WHERE region IS NOT NULL"):
            inside.setdefault(row["region"], []).append(row["id"])
        rows = self.select("SELECT * FROM regions ORDER BY id")
        return [region_of(row, sorted(inside.get(row["id"], ()))) for row in rows]

    def view(self, keyframe_id: int) -> DepthFrame | None:
        """Return a keyframe's depth image, of which every few pixels are left, if it was kept."""
        rows = self.checked_rows("views", "WHERE keyframe_id = ?", keyframe_id)
        if not rows:
            return None
        ((stamp_s,),) = self.select("SELECT stamp_s FROM keyframes WHERE id = ?", keyframe_id)
        return thicken(self.thin(rows[0]), stamp_s)

    def loops(self) -> list[Loop]:
        """Return all edges of the graph, in the order they entered it."""
        return [loop_of(row) for row in self.select("SELECT * FROM loops")]

    def candidates(self) -> list[Candidate]:
        """Return the audit trail, in the order it came."""
        return [candidate_of(row) for row in self.select("SELECT * FROM candidates ORDER BY id")]

    def checked_rows(self, table: str, tail: str, *values: object) -> list[Any]:
        """Return rows of a table that are as they were written; ``MapError`` names the first else.

        ``tail`` is what follows the table's name in the statement.
        """
        rows = self.select(f"SELECT * FROM {table} {tail}", *values)
        for row in rows:
            if row_crc(*tuple(row)[:-1]) != row["crc"]:
                raise MapError(
                    f"{self.path}: found a damaged row of {table}, {row[CHECKED[table]]}; "
                    "slam-bof map check names all there are, slam-bof map recover saves the rest"
                )
        return rows

    def thin(self, row: Any) -> ThinDepth:
        """Return what a row of ``views`` keeps of a depth image; ``MapError`` if it is damaged."""
        camera = self.intrinsics()
        thin = None if camera is None else thin_of(row, camera)
        if thin is None:
            raise MapError(
                f"{self.path}: found a damaged depth image of keyframe {row['keyframe_id']}, "
                "expected a 16-bit PNG"
            )
        return thin

    def _add_frames(
        self, db: sqlite3.Connection, session: int, first: int, frames: Iterable[FramePose]
    ) -> None:
        rows = [frame_row(session, first + k, frame) for k, frame in enumerate(frames)]
        db.executemany(INSERT_FRAME, rows)
        sign(db, "frames", "session = ? AND frame_index >= ?", session, first)

    def _add_candidates(self, db: sqlite3.Connection, record: KeyframeRecord) -> None:
        """Add a keyframe's candidates with their edges, and take in those held back so far."""
        id_ = int(record.keyframe.id)
        ((next_id,),) = db.execute("SELECT coalesce(max(loop_id) + 1, 0) FROM candidates")
        order = {_pair(loop): next_id + k for k, loop in enumerate(record.admitted)}
        measured = {_pair(loop): loop for loop in record.measured}
        for candidate in record.candidates:
            pair = (candidate.query_id, candidate.match_id, candidate.source)
            loop_id = order.pop(pair, None)
            by = None if loop_id is None else id_
            edge = edge_row(measured.get(pair), loop_id=loop_id, admitted_by=by)
            db.execute(INSERT_CANDIDATE, candidate_row(candidate, edge))
        # A loop that was held back until others agreed was a candidate of an earlier keyframe.
        for pair, loop_id in order.items():
            found = db.execute(
                "UPDATE candidates SET decision = 'accepted', reason = '', loop_id = ?,"
                " admitted_by = ? WHERE query_id = ? AND match_id = ? AND source = ?"
                " AND loop_id IS NULL",
                (loop_id, id_, *pair),
            )
            if found.rowcount != 1:
                raise ValueError(f"{self.path}: loop {pair} is no candidate of the map")
        sign(db, "candidates", "query_id = ?1 OR admitted_by = ?1", id_)

    def _keep(self, db: sqlite3.Connection, key: str, value: object) -> None:
        """Save what is the same of all keyframes; ``ValueError`` if it is not."""
        text = json.dumps(value)
        row = db.execute("SELECT value FROM parameters WHERE key = ?", (key,)).fetchone()
        if row is None:
            _set(db, key, text)
        elif row["value"] != text:
            raise ValueError(f"{self.path}: {key} must stay {row['value']}, got {text}")


def _pair(loop: Loop) -> tuple[int, int, str]:
    """Return what a loop and its candidate share."""
    return int(loop.query_id), int(loop.match_id), loop.source


def _set(db: sqlite3.Connection, key: str, value: object) -> None:
    text = value if isinstance(value, str) else json.dumps(value)
    db.execute("REPLACE INTO parameters (key, value) VALUES (?, ?)", (key, text))
    sign(db, "parameters", "key = ?", key)
