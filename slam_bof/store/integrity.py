"""Checks a map for damage and names each damaged row."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Set
from pathlib import Path
from typing import NamedTuple

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_checks import find_fault
from slam_bof.store.row_codec import decode_view
from slam_bof.store.schema import KEY_COLUMNS
from slam_bof.store.sqlite import as_map_errors, possible_rowids

__all__ = ["Damage", "check_map", "require_intact"]

NAMES = {
    "sessions": "session",
    "keyframes": "keyframe",
    "views": "depth image of keyframe",
    "constellations": "constellation of keyframe",
    "frames": "frame, row",
    "candidates": "candidate",
    "odometry": "state of the odometry,",
    "regions": "room",
    "parameters": "parameter",
}
MAX_MESSAGES = 20
"""Limit on SQLite's own messages; one broken page makes hundreds."""


DAMAGE_CODES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB, sqlite3.SQLITE_TOOBIG)


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
    with MapStore.open(path) as store, store.snapshot(), as_map_errors(Path(path)):
        db = store.connection
        # Damaged text may not be valid UTF-8; the checksum of its row reports it.
        db.text_factory = lambda text: text.decode(errors="surrogateescape")
        found = [Damage(None, None, text) for text in _sqlite_findings(db)]
        for table in KEY_COLUMNS:
            found += _check_rows(db, table)
        found += _check_references(store, {(damage.table, damage.row) for damage in found})
        if not found:
            store.is_checked = True
            found += _unreadable(store)
        return found


def require_intact(path: Path | str) -> None:
    """Raise ``MapError`` if a map is damaged: copying it would sign the damage with new checksums.

    Raises
    ------
    MapError
        The first damage is named.
    """
    if found := check_map(path):
        raise MapError(
            f"{path}: found damage in {len(found)} place{'s' if len(found) > 1 else ''}, the first "
            f"is {found[0]}; expected a whole map: slam-bof map recover saves the rest"
        )


def _unreadable(store: MapStore) -> Iterator[Damage]:
    """Yield what readers refuse of whole rows: numbers that do not count from 0, and the like."""
    try:
        store.keyframes(), store.candidates(), store.rooms()
        for session in store.sessions():
            store.frames(session.id)
    except MapError as error:
        yield Damage(None, None, str(error).removeprefix(f"{store.path}: "))


def _sqlite_findings(db: sqlite3.Connection) -> Iterator[str]:
    """Yield the faults that SQLite finds in the structure of the file."""
    try:
        for (text,) in db.execute(f"PRAGMA integrity_check({MAX_MESSAGES})"):
            if text != "ok":
                yield f"file: {' '.join(text.split())}"
        for row in db.execute("PRAGMA foreign_key_check"):
            yield f"{row['table']}, row {row['rowid']}: refers to a row that is missing"
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        _raise_unless_damage(error)
        yield f"file: {error}"


def _check_rows(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the rows of a table that cannot be read or whose checksum differs."""
    key = KEY_COLUMNS[table]
    found = []
    try:
        for row in db.execute(f"SELECT * FROM {table} ORDER BY rowid"):
            if fault := find_fault(table, row):
                found.append(Damage(table, row[key], fault))
    except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
        _raise_unless_damage(error)
        yield from _check_rows_one_by_one(db, table)
        return
    yield from found


def _check_rows_one_by_one(db: sqlite3.Connection, table: str) -> Iterator[Damage]:
    """Yield the damaged rows of a table with a broken page: each possible row is read alone."""
    for rowid in possible_rowids(db, table):
        try:
            row = db.execute(f"SELECT * FROM {table} WHERE rowid = ?", (rowid,)).fetchone()
        except sqlite3.DatabaseError as error:
            yield Damage(table, rowid, f"cannot be read: {error}")
            continue
        if row is not None and (fault := find_fault(table, row)):
            yield Damage(table, row[KEY_COLUMNS[table]], fault)


def _raise_unless_damage(error: sqlite3.DatabaseError | UnicodeDecodeError) -> None:
    """Raise an error again unless it reports a damaged file, maybe in damaged text."""
    if (
        isinstance(error, sqlite3.DatabaseError)
        and error.sqlite_errorcode & 0xFF not in DAMAGE_CODES
    ):
        raise error


def _check_references(
    store: MapStore, damaged: Set[tuple[str | None, int | str | None]]
) -> Iterator[Damage]:
    """Yield parameters, keyframes, images and frames that are missing, and images that are none."""
    try:
        camera, has_classes = store.intrinsics(), bool(store.classes())
    except MapError:
        return  # the damage behind this is reported already
    ids = [row["id"] for row in store.select("SELECT id FROM keyframes ORDER BY id")]
    labelled = store.select("SELECT 1 FROM keyframes WHERE scene IS NOT NULL LIMIT 1")
    if labelled and not has_classes:
        yield Damage("parameters", "classes", "is missing")
    for missing in sorted(set(range(len(ids))) - set(ids)):
        yield Damage("keyframes", missing, "is missing")
    seen = [row["keyframe_id"] for row in store.select("SELECT keyframe_id FROM views")]
    if seen:  # maps made before version 4 have no depth images
        if camera is None:
            yield Damage("parameters", "camera", "is missing")
        for id_ in sorted(set(ids) - set(seen)):
            yield Damage("views", id_, "is missing")
    for id_ in seen:
        if camera is None or ("views", id_) in damaged:
            continue
        rows = store.select("SELECT * FROM views WHERE keyframe_id = ?", id_)
        # An index may have a row that cannot be read, where a page of the database is broken.
        if not rows or decode_view(rows[0], camera) is None:
            yield Damage("views", id_, f"is no 16-bit PNG of the size that {camera} has")
    for (session,) in store.select("SELECT id FROM sessions"):
        indices = [
            row["frame_index"]
            for row in store.select(
                "SELECT frame_index FROM frames WHERE session = ? ORDER BY frame_index", session
            )
        ]
        for missing in sorted(set(range(len(indices))) - set(indices)):
            yield Damage("frames", missing, f"of session {session} is missing")
