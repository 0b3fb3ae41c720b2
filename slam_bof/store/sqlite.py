"""How map.db is opened, how its rows are signed, and what errors of SQLite mean."""

from __future__ import annotations

import os
import sqlite3
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slam_bof.errors import MapError

__all__ = ["connect", "naming_errors", "row_crc", "sign"]

BUSY_TIMEOUT_S = 5.0


FOUND = {
    sqlite3.SQLITE_NOTADB: "found no SQLite database, expected a map.db",
    sqlite3.SQLITE_CORRUPT: "found a damaged database, expected a map.db",
    sqlite3.SQLITE_BUSY: "found it locked by another program that writes to it, "
    "expected to be the only one; try again when that is done",
    sqlite3.SQLITE_FULL: "cannot be written: the disk is full",
    sqlite3.SQLITE_READONLY: "cannot be written: the file or its folder is read-only",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened: expected a folder and file that may be accessed",
    sqlite3.SQLITE_IOERR: "cannot be read or written: the disk reports an error",
    sqlite3.SQLITE_PERM: "cannot be opened: access is not permitted",
}


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open the database: mode "ro" to read, "rw" to write, "rwc" to make it as well.

    Transactions are explicit (``BEGIN``); rows can be indexed by column name. One thread at a
    time may use it.
    """
    path = path.resolve()
    uri = f"{path.as_uri()}?mode={mode}"
    if mode == "ro" and not Path(f"{path}-wal").exists() and not os.access(path.parent, os.W_OK):
        # SQLite wants to put its lock files beside; on read-only media nothing can change.
        uri += "&immutable=1"
    db = sqlite3.connect(
        uri, timeout=BUSY_TIMEOUT_S, isolation_level=None, uri=True, check_same_thread=False
    )
    prepare(db)
    db.execute("PRAGMA foreign_keys = ON")
    db.execute("PRAGMA synchronous = NORMAL")
    return db


def prepare(db: sqlite3.Connection) -> None:
    """Let rows be indexed by column name, and SQL compute ``row_crc``."""
    db.row_factory = sqlite3.Row
    db.create_function("row_crc", -1, row_crc, deterministic=True)


def row_crc(*values: float | str | bytes | None) -> int:
    """Return the CRC-32 of a row's values; a number counts as the float64 that it is."""
    crc = 0
    for value in values:
        if value is None:
            data = b"\0"
        elif isinstance(value, bytes):
            data = value
        elif isinstance(value, str):
            data = value.encode(errors="surrogateescape")
        else:
            data = struct.pack("<d", value)
        crc = zlib.crc32(data, zlib.crc32(struct.pack("<q", len(data)), crc))
    return crc


def sign(db: sqlite3.Connection, table: str, where: str = "TRUE", *values: object) -> None:
    """Bring the ``crc`` of rows up to date."""
    db.execute(
        f"UPDATE {table} SET crc = row_crc({', '.join(columns(db, table))}) WHERE {where}", values
    )


def columns(db: sqlite3.Connection, table: str) -> list[str]:
    """Return the names of a table's columns but for ``crc``."""
    rows = db.execute(f"PRAGMA table_info({table})").fetchall()
    return [row["name"] for row in rows if row["name"] != "crc"]


@contextmanager
def naming_errors(path: Path, *, otherwise: int | None = None) -> Iterator[None]:
    """Turn what SQLite reports of a file into one line; leave what is a bug alone.

    ``otherwise`` is SQLite's code of what it comes to where SQLite has no more than words: a file
    may be so damaged that its tables are other ones.

    Raises
    ------
    MapError
        If the file is no database, damaged, locked, read-only, or the disk is full.
    ValueError
        If a row breaks a constraint: a keyframe twice, or one that is not there.
    """
    try:
        yield
    except sqlite3.IntegrityError as error:
        raise ValueError(f"{path}: the row does not fit the map: {error}") from error
    except (sqlite3.OperationalError, sqlite3.DatabaseError) as error:
        # The low byte is the primary code of SQLite's extended error codes.
        found = FOUND.get(getattr(error, "sqlite_errorcode", 0) & 0xFF)
        if found is None and "Could not decode" in str(error):
            found = FOUND[sqlite3.SQLITE_CORRUPT]  # a flipped byte in a text
        if found is None and otherwise is not None:
            found = FOUND[otherwise]
        if found is None:
            raise
        raise MapError(f"{path}: {found}") from error
