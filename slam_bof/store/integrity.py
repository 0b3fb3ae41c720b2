"""Checks a map for damage and names each damaged row."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import decode_view
from slam_bof.store.schema import KEY_COLUMNS
from slam_bof.store.sqlite import as_map_errors, is_intact

__all__ = ["Damage", "check_map"]

NAMES = {
    "sessions": "session",
    "keyframes": "keyframe",
    "views": "depth image of keyframe",
    "frames": "frame, row",
    "candidates": "candidate",
    "regions": "room",
    "parameters": "parameter",
}
CHECKSUM_DIFFERS = "differs from what was written (checksum)"
MAX_MESSAGES = 20
"""Limit on SQLite's own messages; one broken page makes hundreds."""


class Damage(NamedTuple):
    """Something damaged or missing; ``row`` is None if it is not a single row."""

    table: str | None
    row: int | str | None
    found: str

    def __str__(self) -> str:
        """Return the damage as text."""
        if self.table is None:
            return self.found
        return f"{NAMES[self.table]} {self.row}: {self.found}"


def check_map(path: Path | str) -> list[Damage]:
    """Return the damage found in a map, an empty list if the map is intact.

    SQLite checks the structure of the file. In addition, each row is compared with its ``crc``,
    and rows that belong together must all be present.

    Raises
    ------
    MapError
        If the file is not a map, or not even its tables can be read.
    """
    with MapStore.open(path) as store:
        db = store.connection
        # Damaged text may not be valid UTF-8; the checksum of its row reports it.
        db.text_factory = lambda text: text.decode(errors="surrogateescape")
        found = [Damage(None, None, text) for text in _sqlite_findings(db)]
        damaged: set[tuple[str, int | str]] = set()
        for table in KEY_COLUMNS:
            for damage in _check_rows(db, table):
                assert damage.row is not None
                damaged.add((table, damage.row))
                found.append(damage)
        with as_map_errors(Path(path)):
            found += _check_references(store, damaged)
        return found


def _sqlite_findings(db: sqlite3.Connection) -> Iterator[str]:
    """Yield the faults that SQLite finds in the structure of the file."""
    try:
        for (text,) in db.execute(f"PRAGMA integrity_check({MAX_MESSAGES})"):
            if text != "ok":
                yield f"file: {' '.join(text.split())}"
        for row in db.execute("PRAGMA foreign_key_check"):
            yield f"{row['table']}, row {row['rowid']}: refers to a row that is missing"
    except sqlite3.DatabaseError as error:
        _raise_unless_damage(error)
        yield f"file: {error}"


def _check_rows(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the rows of a table that cannot be read or whose checksum differs."""
    key = KEY_COLUMNS[table]
    try:
        rows = db.execute(f"SELECT {key} AS key, * FROM {table} ORDER BY rowid").fetchall()
    except sqlite3.DatabaseError as error:
        _raise_unless_damage(error)
        yield from _check_rows_one_by_one(db, table)
        return
    for row in rows:
        if not is_intact(tuple(row)[1:]):
            yield Damage(table, row["key"], CHECKSUM_DIFFERS)


def _check_rows_one_by_one(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the damaged rows of a table with a broken page: each possible row is read alone."""
    for rowid in range(_last_rowid(db, table) + 1):
        try:
            row = db.execute(
                f"SELECT {KEY_COLUMNS[table]} AS key, * FROM {table} WHERE rowid = ?", (rowid,)
            ).fetchone()
        except sqlite3.DatabaseError as error:
            yield Damage(table, rowid, f"cannot be read: {error}")
            continue
        if row is not None and not is_intact(tuple(row)[1:]):
            yield Damage(table, row["key"], CHECKSUM_DIFFERS)


def _last_rowid(db: sqlite3.Connection, table: str) -> int:
    try:
        row = db.execute(f"SELECT max(rowid) AS last FROM {table}").fetchone()
    except sqlite3.DatabaseError:
        return -1  # SQLite's own check has reported the damage
    return int(row["last"] or 0)


def _raise_unless_damage(error: sqlite3.DatabaseError) -> None:
    """Raise an error again unless it reports a damaged file."""
    if error.sqlite_errorcode & 0xFF not in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB):
        raise error


def _check_references(store: MapStore, damaged: set[tuple[str, int | str]]) -> Iterator[Damage]:
    """Yield keyframes, depth images and frames that are missing, and images that are no PNG."""
    try:
        ids = [row["id"] for row in store.select("SELECT id FROM keyframes ORDER BY id")]
        camera = store.intrinsics()
        views = store.select("SELECT * FROM views")
        sessions = store.sessions()
    except (MapError, ValueError):
        return  # the damage behind this is reported already
    for missing in sorted(set(range(len(ids))) - set(ids)):
        yield Damage("keyframes", missing, "is missing")
    for row in views:
        if ("views", row["keyframe_id"]) in damaged or camera is None:
            continue
        if decode_view(row, camera) is None:
            yield Damage("views", row["keyframe_id"], "is not a 16-bit PNG")
    if views:  # maps made before version 4 have no depth images
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
