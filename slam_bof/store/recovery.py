"""What is whole of a damaged map, saved into a new one."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from slam_bof.errors import ConfigError, MapError
from slam_bof.slam import config as configs
from slam_bof.store.map_store import MapStore
from slam_bof.store.pruning import drop_keyframes
from slam_bof.store.row_codec import INSERT_FRAME, frame_of, frame_row
from slam_bof.store.schema import CHECKED, SMOOTHED
from slam_bof.store.schema_repair import mend_layout
from slam_bof.store.sqlite import columns, naming_errors, row_crc, sign
from slam_bof.types import LOST, FramePose

__all__ = ["Recovered", "recover_map"]

UNKNOWN = ("", "", "", 0, "", None)
"""Data set, sequence, configuration, seed, version and number of frames of a session."""


class Recovered(NamedTuple):
    """How many keyframes a recovered map has, and how many are lost."""

    n_keyframes: int
    n_lost: int


def recover_map(path: Path | str, out: Path | str) -> Recovered:
    """Copy every row that is as it was written into a new map.

    A keyframe whose row, depth image or frame is damaged is left out with all that names it; ids
    are counted anew. Other frames that are damaged become lost ones, between their neighbours. Of
    a session nothing but what can still be read is needed. A last run that was interrupted counts
    as finished.

    Raises
    ------
    MapError
        If nothing can be read, no keyframe is whole, or there is a file already.
    """
    path, out = Path(path), Path(out)
    with ExitStack() as stack:
        source = stack.enter_context(_open(path, stack))
        # A flipped byte may make a text that is none; its checksum tells.
        source.connection.text_factory = lambda text: text.decode(errors="surrogateescape")
        target = stack.enter_context(MapStore.create(out))
        try:
            with naming_errors(path):
                known = _last_id(source.connection)
            with target.transaction() as db:
                db.execute("PRAGMA defer_foreign_keys = ON")
                for table in CHECKED:
                    _copy(source.connection, db, table)
                _add_sessions(source.connection, db)
                ids = {row["id"] for row in db.execute("SELECT id FROM keyframes")}
                whole = {row["id"] for row in db.execute(WHOLE)}
                _forget_what_is_gone(db)
                drop_keyframes(db, ids - whole)
                _add_frames(db)
        except BaseException:
            out.unlink()
            raise
        if not whole:
            out.unlink()
            raise MapError(f"{path}: found no keyframe that is whole, expected some to save")
    return Recovered(len(whole), max(known, len(ids)) - len(whole))


WHOLE = """
SELECT k.id FROM keyframes AS k
    JOIN views ON keyframe_id = k.id
    JOIN frames AS f ON f.session = k.session AND f.frame_index = k.frame_index
"""


def _open(path: Path, stack: ExitStack) -> MapStore:
    """Open a map, or a copy in which is put back what says how it is read."""
    try:
        return MapStore.open(path)
    except MapError:
        if not path.is_file():
            raise
        copy = Path(stack.enter_context(TemporaryDirectory())) / "map.db"
        for end in ("", "-wal"):
            file = Path(f"{path.resolve()}{end}")
            if file.exists():
                shutil.copyfile(file, f"{copy}{end}")
        try:
            mend_layout(copy)
            return MapStore.open(copy)
        except (sqlite3.DatabaseError, MapError):
            pass  # of which there is nothing more to tell than at first
        raise


def _last_id(db: sqlite3.Connection) -> int:
    """Return how many keyframes there seem to have been."""
    try:
        ((last,),) = db.execute("SELECT max(id) FROM keyframes").fetchall()
    except sqlite3.DatabaseError:
        return 0
    return 0 if last is None else int(last) + 1


def _copy(source: sqlite3.Connection, target: sqlite3.Connection, table: str) -> None:
    """Copy the rows of a table that can be read and are what was written."""
    names = [*columns(source, table), "crc"]
    marks = ", ".join("?" * len(names))
    # A page that is there twice has rows twice.
    insert = f"INSERT OR IGNORE INTO {table} ({', '.join(names)}) VALUES ({marks})"
    select = f"SELECT {', '.join(names)} FROM {table}"
    for rowid in _rowids(source, table):
        try:
            row = source.execute(f"{select} WHERE rowid = ?", (rowid,)).fetchone()
        except sqlite3.DatabaseError:
            continue
        if row is not None and row_crc(*tuple(row)[:-1]) == row["crc"]:
            target.execute(insert, tuple(row))


def _rowids(db: sqlite3.Connection, table: str) -> list[int]:
    """Return the numbers that rows may have."""
    try:
        return [rowid for (rowid,) in db.execute(f"SELECT rowid FROM {table}").fetchall()]
    except sqlite3.DatabaseError:
        pass
    try:
        ((last,),) = db.execute(f"SELECT max(rowid) FROM {table}").fetchall()
    except sqlite3.DatabaseError:
        return []
    return list(range(int(last or 0) + 1))


def _add_sessions(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Add sessions that are damaged, by what can be read of them, and let all be finished."""
    found = {row["id"] for row in target.execute("SELECT id FROM sessions")}
    ((last,),) = target.execute(
        "SELECT max(id) FROM (SELECT id FROM sessions UNION SELECT session FROM keyframes)"
    ).fetchall()
    for id_ in sorted(set(range(-1 if last is None else last + 1)) - found):
        target.execute(
            "INSERT INTO sessions (id, dataset, sequence, config, seed, version, max_frames)"
            " VALUES (?, ?, ?, ?, ?, ?, ?)",
            (id_, *_read_session(source, id_)),
        )
    target.execute("UPDATE sessions SET is_finished = 1, state = NULL")


def _read_session(db: sqlite3.Connection, id_: int) -> tuple[object, ...]:
    """Return of a damaged session what still makes sense, all of it or nothing."""
    try:
        row = db.execute(
            "SELECT dataset, sequence, config, seed, version, max_frames FROM sessions"
            " WHERE id = ?",
            (id_,),
        ).fetchone()
    except sqlite3.DatabaseError:
        return UNKNOWN
    if row is None or any(
        not isinstance(value, (str, int)[is_number])
        for value, is_number in zip(tuple(row)[:5], (0, 0, 0, 1, 0), strict=True)
    ):
        return UNKNOWN
    texts = [text.encode(errors="surrogateescape").decode(errors="replace") for text in row[:3]]
    try:
        configs.parse(texts[2], "")
    except ConfigError:
        texts[2] = ""
    n = row["max_frames"]
    return (*texts, row["seed"], "", n if isinstance(n, int) and n > 0 else None)


def _forget_what_is_gone(db: sqlite3.Connection) -> None:
    """Take back what names a room, a session or a list of scenes that was damaged."""
    db.execute("UPDATE keyframes SET region = NULL WHERE region NOT IN (SELECT id FROM regions)")
    db.execute(
        "UPDATE candidates SET left_out_by = NULL"
        " WHERE left_out_by NOT IN (SELECT id FROM sessions)"
    )
    if not db.execute("SELECT 1 FROM parameters WHERE key = 'classes'").fetchall():
        labels = ("scene", "scene_probability", "probabilities", *list(SMOOTHED)[:3])
        db.execute(f"UPDATE keyframes SET {', '.join(f'{name} = NULL' for name in labels)}")


def _add_frames(db: sqlite3.Connection) -> None:
    """Put lost frames where some are missing between the others, of which all else is counted."""
    for (session,) in db.execute("SELECT id FROM sessions").fetchall():
        rows = db.execute(
            "SELECT * FROM frames WHERE session = ? ORDER BY frame_index", (session,)
        ).fetchall()
        if not rows:
            continue
        there = np.array([row["frame_index"] for row in rows])
        stamps_s = np.array([row["stamp_s"] for row in rows])
        step_s = float(np.median(np.diff(stamps_s) / np.diff(there))) if len(rows) > 1 else 1.0
        for index in sorted(set(range(there[-1])) - set(there.tolist())):
            after = int(np.searchsorted(there, index))
            near = frame_of(rows[max(after - 1, 0)])
            stamp_s = float(np.interp(index, there, stamps_s)) + step_s * min(index - there[0], 0)
            frame = FramePose(
                stamp_s, near.T_odom_raw, near.T_odom_camera, LOST, near.T_view_camera
            )
            db.execute(INSERT_FRAME, frame_row(session, index, frame))
    sign(db, "frames")
