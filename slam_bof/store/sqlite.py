"""SQLite connections, row checksums, and SQLite's errors as ``MapError``."""

from __future__ import annotations

import os
import sqlite3
import struct
import sys
import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from slam_bof.errors import MapError

__all__ = [
    "as_map_errors",
    "columns",
    "connect",
    "is_intact",
    "possible_rowids",
    "prepare",
    "row_crc",
    "update_checksums",
]

BUSY_TIMEOUT_S = 5.0
LENGTH, NUMBER = struct.Struct("<q"), struct.Struct("<qd")
NULL = LENGTH.pack(1) + b"\0"
MIN_ROW_BYTES = 32
"""Least size of a row of any table."""
MAX_VALUE_BYTES = 1 << 24
"""Largest text or blob that is read; a depth image takes some 13 kB."""

ERROR_MESSAGES = {
    sqlite3.SQLITE_NOTADB: "found no SQLite database, expected a map.db",
    sqlite3.SQLITE_CORRUPT: "found a damaged database, expected a map.db",
    sqlite3.SQLITE_BUSY: "found it locked by another program that writes to it, "
    "expected no other writer; try again when that program is done",
    sqlite3.SQLITE_FULL: "cannot be written: the disk is full",
    sqlite3.SQLITE_READONLY: "cannot be written: the file or its folder is read-only",
    sqlite3.SQLITE_CANTOPEN: "cannot be opened: expected a folder and file that may be accessed",
    sqlite3.SQLITE_IOERR: "cannot be read or written: the disk reports an error",
    sqlite3.SQLITE_PERM: "cannot be opened: access is not permitted",
    sqlite3.SQLITE_TOOBIG: f"found a value of more than {MAX_VALUE_BYTES} bytes, "
    "expected smaller ones",
}


def connect(path: Path, mode: str) -> sqlite3.Connection:
    """Open a database to read ("ro"), to write ("rw"), or to create and write ("rwc").

    Transactions are explicit (``BEGIN``) and rows can be indexed by column name. The connection
    may be used by one thread at a time.
    """
    path = Path(os.path.realpath(path))  # resolve() raises for links in a circle
    uri = f"{path.as_uri()}?mode={mode}"
    if mode == "ro" and not Path(f"{path}-wal").exists() and not os.access(path.parent, os.W_OK):
        # SQLite cannot create lock files in a read-only folder, where nothing can change anyway.
        uri += "&immutable=1"
    db = sqlite3.connect(
        uri, timeout=BUSY_TIMEOUT_S, isolation_level=None, uri=True, check_same_thread=False
    )
    prepare(db)
    db.execute("PRAGMA foreign_keys = ON")
    db.execute("PRAGMA synchronous = NORMAL")
    return db


def prepare(db: sqlite3.Connection) -> None:
    """Make rows indexable by column name and ``row_crc`` callable from SQL.

    The file may come from anybody: its views and indices may call no functions with side effects,
    its values have a largest size, and no statement may damage the file (from Python 3.12 on).
    """
    db.row_factory = sqlite3.Row
    db.create_function("row_crc", -1, row_crc, deterministic=True)
    db.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)
    db.execute("PRAGMA trusted_schema = OFF")
    if sys.version_info >= (3, 12):
        db.setconfig(sqlite3.SQLITE_DBCONFIG_DEFENSIVE)


def row_crc(*values: float | str | bytes | None) -> int:
    """Return the CRC-32 of a row's values, each after its length; numbers are float64."""
    parts: list[bytes] = []
    for value in values:
        kind = type(value)
        if kind is float or kind is int:
            parts.append(NUMBER.pack(8, value))
        elif value is None:
            parts.append(NULL)
        else:
            data = (
                value if isinstance(value, bytes) else str(value).encode(errors="surrogateescape")
            )
            parts += LENGTH.pack(len(data)), data
    return zlib.crc32(b"".join(parts))


def is_intact(values: Sequence[Any]) -> bool:
    """Return whether a row's last value, its ``crc``, is the checksum of the values before it."""
    return bool(row_crc(*values[:-1]) == values[-1])


def update_checksums(
    db: sqlite3.Connection, table: str, where: str = "TRUE", *values: object
) -> None:
    """Recompute the ``crc`` of the rows that meet a condition."""
    db.execute(
        f"UPDATE {table} SET crc = row_crc({', '.join(columns(db, table))}) WHERE {where}", values
    )


def columns(db: sqlite3.Connection, table: str) -> list[str]:
    """Return the names of a table's columns, except ``crc``."""
    rows = db.execute(f"PRAGMA table_info({table})").fetchall()
    return [row["name"] for row in rows if row["name"] != "crc"]


def possible_rowids(db: sqlite3.Connection, table: str) -> range:
    """Return the row numbers to try where a table has broken pages.

    The largest may be damaged itself: there are no more rows than fit into the file.
    """
    try:
        ((last,),) = db.execute(f"SELECT max(rowid) FROM {table}").fetchall()
        ((n_pages,),) = db.execute("PRAGMA page_count").fetchall()
        ((page_bytes,),) = db.execute("PRAGMA page_size").fetchall()
    except (sqlite3.DatabaseError, UnicodeDecodeError):
        return range(0)
    return range(min(int(last or 0) + 1, n_pages * page_bytes // MIN_ROW_BYTES))


@contextmanager
def as_map_errors(path: Path, *, otherwise: int | None = None) -> Iterator[None]:
    """Raise SQLite's errors about a file as ``MapError``; programming errors pass unchanged.

    Parameters
    ----------
    path
        The map, named in the message.
    otherwise
        SQLite's error code to report where its error has no known code: a damaged file may look
        like a valid one with other tables.

    Raises
    ------
    MapError
        If the file is not a database, is damaged, locked or read-only, or the disk is full.
    ValueError
        If a row breaks a constraint, such as a second keyframe of the same id.
    """
    try:
        yield
    except sqlite3.IntegrityError as error:
        raise ValueError(f"{path}: the row does not fit the map: {error}") from error
    except UnicodeDecodeError as error:  # of the text of an error about a damaged schema
        raise MapError(f"{path}: {ERROR_MESSAGES[sqlite3.SQLITE_CORRUPT]}") from error
    except (sqlite3.OperationalError, sqlite3.DatabaseError) as error:
        # The low byte is the primary code of SQLite's extended error codes.
        found = ERROR_MESSAGES.get(getattr(error, "sqlite_errorcode", 0) & 0xFF)
        if found is None and "Could not decode" in str(error):
            found = ERROR_MESSAGES[sqlite3.SQLITE_CORRUPT]  # damaged text
        if found is None and otherwise is not None:
            found = ERROR_MESSAGES[otherwise]
        if found is None:
            raise
        raise MapError(f"{path}: {found}") from error
