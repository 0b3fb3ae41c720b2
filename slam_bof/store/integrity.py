"""Is a map whole? What is damaged is found and named, row by row."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import thin_of
from slam_bof.store.schema import CHECKED
from slam_bof.store.sqlite import naming_errors, row_crc

__all__ = ["Damage", "check_map"]

NAMES = {
    "sessions": "session",
    "keyframes": "keyframe",
    "views": "depth image of keyframe",
    "frames": "frame, row",
    "candidates": "candidate",
    "regions": "region",
    "parameters": "parameter",
}
MAX_MESSAGES = 20
"""So many remarks of SQLite's own are told; one broken page makes hundreds."""


class Damage(NamedTuple):
    """Something that is not as it was written; ``row`` is None if it is no single row."""

    table: str | None
    row: int | str | None
    found: str

    def __str__(self) -> str:
        """Return it in words."""
        if self.table is None:
            return self.found
        return f"{NAMES[self.table]} {self.row}: {self.found}"


def check_map(path: Path | str) -> list[Damage]:
    """Return all that is wrong with a map, nothing if it is whole.

    SQLite's own check is of the file's structure; each row is held against its ``crc`` as well,
    and what belongs together must be there.

    Raises
    ------
    MapError
        If nothing of it can be read: no map, not even its tables.
    """
    with MapStore.open(path) as store:
        db = store.connection
        # A flipped byte may make a text that is none; it is told of by its checksum.
        db.text_factory = lambda text: text.decode(errors="surrogateescape")
        found = [Damage(None, None, text) for text in _complaints(db)]
        damaged: set[tuple[str, int | str]] = set()
        for table in CHECKED:
            for damage in _check_rows(db, table):
                assert damage.row is not None
                damaged.add((table, damage.row))
                found.append(damage)
        with naming_errors(Path(path)):
            found += _check_sense(store, damaged)
        return found


def _complaints(db: sqlite3.Connection) -> Iterator[str]:
    """Yield what SQLite finds wrong with the structure of the file."""
    try:
        for (text,) in db.execute(f"PRAGMA integrity_check({MAX_MESSAGES})"):
            if text != "ok":
                yield f"file: {' '.join(text.split())}"
        for row in db.execute("PRAGMA foreign_key_check"):
            yield f"{row['table']}, row {row['rowid']}: names what is not there"
    except sqlite3.DatabaseError as error:
        _pass_on_bugs(error)
        yield f"file: {error}"


def _check_rows(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the rows of a table that cannot be read or are not what was written."""
    key = CHECKED[table]
    try:
        rows = db.execute(f"SELECT {key} AS key, * FROM {table} ORDER BY rowid").fetchall()
    except sqlite3.DatabaseError as error:
        _pass_on_bugs(error)
        yield from _check_singly(db, table)
        return
    for row in rows:
        if not _is_whole(row):
            yield Damage(table, row["key"], "is not what was written: its checksum differs")


def _check_singly(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the same where a page is broken: each row by its number, as far as there may be."""
    for rowid in range(_last_rowid(db, table) + 1):
        try:
            row = db.execute(
                f"SELECT {CHECKED[table]} AS key, * FROM {table} WHERE rowid = ?", (rowid,)
            ).fetchone()
        except sqlite3.DatabaseError as error:
            yield Damage(table, rowid, f"cannot be read: {error}")
            continue
        if row is not None and not _is_whole(row):
            yield Damage(table, row["key"], "is not what was written: its checksum differs")


def _last_rowid(db: sqlite3.Connection, table: str) -> int:
    try:
        row = db.execute(f"SELECT max(rowid) AS last FROM {table}").fetchone()
    except sqlite3.DatabaseError:
        return -1  # whose damage is told of already
    return int(row["last"] or 0)


def _is_whole(row: Any) -> bool:
    values = tuple(row)
    return bool(row_crc(*values[1:-1]) == values[-1])


def _pass_on_bugs(error: sqlite3.DatabaseError) -> None:
    """Raise again what is no damage of the file."""
    if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
        raise error


def _check_sense(store: MapStore, damaged: set[tuple[str, int | str]]) -> Iterator[Damage]:
    """Yield what is there but does not fit together."""
    try:
        ids = [row["id"] for row in store.select("SELECT id FROM keyframes ORDER BY id")]
        camera = store.intrinsics()
        views = store.select("SELECT * FROM views")
        sessions = store.sessions()
    except (MapError, ValueError):
        return  # told of already
    for missing in sorted(set(range(len(ids))) - set(ids)):
        yield Damage("keyframes", missing, "is missing")
    for row in views:
        if ("views", row["keyframe_id"]) in damaged or camera is None:
            continue
        if thin_of(row, camera) is None:
            yield Damage("views", row["keyframe_id"], "is no 16-bit PNG")
    if views:  # maps made before version 4 have none
        seen = {row["keyframe_id"] for row in views}
        for id_ in sorted(set(ids) - seen):
            yield Damage("views", id_, "is missing")
    for session in sessions:
        rows = store.select(
            "SELECT frame_index FROM frames WHERE session = ? ORDER BY frame_index", session.id
        )
        indices = [row["frame_index"] for row in rows]
        for missing in sorted(set(range(len(indices))) - set(indices)):
            yield Damage("frames", missing, f"of session {session.id} is missing")
