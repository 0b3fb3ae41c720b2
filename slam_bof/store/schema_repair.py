"""Check and repair of a map's file header and schema statements.

These are the same in every map, so damaged bytes in them can be restored.
"""

from __future__ import annotations

import re
import sqlite3
from collections.abc import Iterable, Sequence, Set
from contextlib import closing
from functools import cache
from pathlib import Path

from slam_bof.store.schema import APPLICATION_ID, SCHEMA, SCHEMA_VERSION

__all__ = ["STATEMENTS", "check_schema", "find_additions", "has_header", "repair_schema"]

MAGIC = b"SQLite format 3\0"
HEADER_BYTES = 100
STATISTICS = re.compile("sqlite_stat[1-4]")
"""Tables that SQLite's ANALYZE makes."""
MAX_BAD_BYTES = 2
"""A file that differs from ``MAGIC`` in more bytes than this is not taken for a damaged map."""
STATEMENTS = "SELECT type, name, tbl_name, sql FROM sqlite_schema ORDER BY rowid"

Statement = tuple[str, str, str, str | None]


def check_schema(db: sqlite3.Connection) -> str:
    """Return what differs from the schema of a map, "" if nothing does.

    A user's own index is allowed. Other additions are not: a trigger would run when the map is
    written, and a view when it is read.
    """
    found = {tuple(row) for row in db.execute(STATEMENTS)}
    wrong = [
        f"{kind} {name}" for kind, name, *rest in _expected() if (kind, name, *rest) not in found
    ]
    if wrong:
        return f"a damaged database schema ({', '.join(wrong)})"
    return find_additions({(kind, name) for kind, name, *_ in _expected()}, found)


def find_additions(expected: Set[tuple[str, str]], found: Iterable[Sequence[str]]) -> str:
    """Return which statements are neither of a map, as (type, name), nor an index; "" if none."""
    added = sorted(
        f"{kind} {name[:40]!r}"
        for kind, name, *_ in found
        if (kind, name) not in expected and kind != "index" and not STATISTICS.fullmatch(name)
    )
    return f"{', '.join(added[:5])} in the database, which slam_bof has not made" if added else ""


def has_header(path: Path) -> bool:
    """Return whether a file begins as a database, perhaps a damaged one."""
    with path.open("rb") as file:
        header = file.read(HEADER_BYTES)
    return len(header) == HEADER_BYTES and _n_different(header, MAGIC) <= MAX_BAD_BYTES


def repair_schema(path: Path) -> None:
    """Restore the file header and the schema statements of a damaged map, in place.

    Raises
    ------
    sqlite3.DatabaseError
        If the file is not an SQLite database, or has too many or too few schema statements.
    """
    has_wal = Path(f"{path}-wal").exists()
    if not has_header(path):
        raise sqlite3.DatabaseError("file is not a database")
    with path.open("r+b") as file:
        header = bytearray(file.read(HEADER_BYTES))
        file.seek(0)
        file.write(_repaired_header(header, has_wal=has_wal))
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        db.execute("PRAGMA writable_schema = ON")  # also reads a schema that is damaged
        rowids = [rowid for (rowid,) in db.execute("SELECT rowid FROM sqlite_schema ORDER BY 1")]
        if len(rowids) != len(_expected()):
            raise sqlite3.DatabaseError("statements are missing")
        db.executemany(
            "UPDATE sqlite_schema SET type = ?, name = ?, tbl_name = ?, sql = ? WHERE rowid = ?",
            [(*statement, rowid) for statement, rowid in zip(_expected(), rowids, strict=True)],
        )


@cache
def _expected() -> tuple[Statement, ...]:
    with closing(sqlite3.connect(":memory:")) as db:
        db.executescript(SCHEMA)
        return tuple(db.execute(STATEMENTS).fetchall())


def _repaired_header(header: bytearray, *, has_wal: bool) -> bytes:
    """Return the header (100,) with the values of every map, and the page count unset.

    See https://www.sqlite.org/fileformat.html, section 1.3.
    """
    form = 2 if has_wal else 1
    header[0:24] = MAGIC + (4096).to_bytes(2, "big") + bytes([form, form, 0, 64, 32, 32])
    header[32:40] = bytes(8)  # no free pages: their space is lost, but no data
    header[44:48] = (4).to_bytes(4, "big")
    header[52:60] = (1).to_bytes(8, "big")  # no auto-vacuum; UTF-8
    header[60:64] = SCHEMA_VERSION.to_bytes(4, "big")
    header[64:68] = bytes(4)
    header[68:72] = APPLICATION_ID.to_bytes(4, "big")
    header[72:96] = bytes(24)  # no valid page count: SQLite takes the size of the file
    return bytes(header)


def _n_different(found: bytes | bytearray, expected: bytes) -> int:
    return sum(a != b for a, b in zip(found, expected, strict=False))
