"""What is whole of a damaged map, saved into a new one."""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import NamedTuple

from slam_bof.errors import MapError
from slam_bof.pruning import drop_keyframes
from slam_bof.schema import CHECKED, columns, naming_errors, row_crc
from slam_bof.store import MapStore

__all__ = ["Recovered", "recover_map"]


class Recovered(NamedTuple):
    """How many keyframes a recovered map has, and how many are lost."""

    n_keyframes: int
    n_lost: int


def recover_map(path: Path | str, out: Path | str) -> Recovered:
    """Copy every row that is as it was written into a new map.

    A keyframe whose row, depth image or frame is damaged is left out with all that names it; ids
    are counted anew. A last run that was interrupted counts as finished.

    Raises
    ------
    MapError
        If nothing can be read, no keyframe is whole, or there is a file already.
    """
    out = Path(out)
    with MapStore.open(path) as source, MapStore.create(out) as target:
        try:
            with naming_errors(Path(path)):
                known = _last_id(source.connection)
            with target.transaction() as db:
                for table in CHECKED:
                    _copy(source.connection, db, table)
                ids = {row["id"] for row in db.execute("SELECT id FROM keyframes")}
                whole = {row["id"] for row in db.execute(WHOLE)}
                db.execute("UPDATE sessions SET is_finished = 1, state = NULL")
                drop_keyframes(db, ids - whole)
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
    JOIN sessions ON sessions.id = k.session
    JOIN frames AS f ON f.session = k.session AND f.frame_index = k.frame_index
"""


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
    insert = f"INSERT INTO {table} ({', '.join(names)}) VALUES ({marks})"
    select = f"SELECT {', '.join(names)} FROM {table}"
    target.execute("PRAGMA defer_foreign_keys = ON")
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
