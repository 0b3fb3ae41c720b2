"""Migration of maps of older schema versions to the current one."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from slam_bof.errors import MapError
from slam_bof.store.row_checks import find_fault
from slam_bof.store.schema import (
    CONSTELLATIONS_TABLE,
    CULLED_TABLE,
    KEY_COLUMNS,
    ODOMETRY_TABLE,
    POSE_COLUMNS,
    SCHEMA_VERSION,
    SMOOTHED_COLUMNS,
    TABLES,
    VIEWS,
)
from slam_bof.store.schema_repair import STATEMENTS, find_additions
from slam_bof.store.sqlite import columns, prepare, update_checksums

__all__ = ["MIGRATABLE_VERSIONS", "migrate"]

_ADD_COLUMN = "ALTER TABLE keyframes ADD COLUMN {} {};"

_TO_3 = f"""
{"".join(_ADD_COLUMN.format(name, kind) for name, kind in SMOOTHED_COLUMNS.items())}
CREATE TABLE regions (
    id INTEGER PRIMARY KEY, label TEXT, probability REAL, n_keyframes INTEGER,
    center_x REAL, center_y REAL, center_z REAL,
    low_x REAL, low_y REAL, low_z REAL, high_x REAL, high_y REAL, high_z REAL
);
"""

_OLD = ("keyframes", "candidates", "regions", "parameters", "loops")
_TABLES_6 = tuple(name for name in KEY_COLUMNS if name != "odometry")
_TABLES_5 = tuple(name for name in _TABLES_6 if name != "constellations")
_TABLES_4 = tuple(name for name in _TABLES_5 if name != "culled")
_ADDED = ((5, CULLED_TABLE), (6, CONSTELLATIONS_TABLE), (7, ODOMETRY_TABLE))
"""Tables by the version that added them."""
_OLD_VIEWS = ("keyframe_labels", "loop_audit")

_TO_4 = f"""
DROP VIEW keyframe_labels;
DROP VIEW loop_audit;
DROP INDEX candidates_by_query;
DROP INDEX loops_by_query;
{"".join(f"ALTER TABLE {table} RENAME TO old_{table};" for table in _OLD)}
{TABLES}
INSERT INTO parameters (key, value)
    SELECT key, value FROM old_parameters WHERE key IN ('classes', 'model');
INSERT INTO sessions (id, dataset, sequence, config, seed, version, is_finished) VALUES (0,
    coalesce((SELECT value FROM old_parameters WHERE key = 'dataset'), ''),
    coalesce((SELECT value FROM old_parameters WHERE key = 'sequence'), ''),
    coalesce((SELECT value FROM old_parameters WHERE key = 'config'), ''),
    coalesce((SELECT value FROM old_parameters WHERE key = 'seed'), 0), '', 1);
"""

_LOOPS_TO_4 = f"""
UPDATE candidates SET
    ({", ".join(POSE_COLUMNS)}, information, loop_id, admitted_by, decision) =
    (SELECT {", ".join(POSE_COLUMNS)}, information, id, candidates.query_id, 'accepted'
        FROM old_loops AS l WHERE l.query_id = candidates.query_id
        AND l.match_id = candidates.match_id AND l.source = candidates.source)
    WHERE EXISTS (SELECT 1 FROM old_loops AS l WHERE l.query_id = candidates.query_id
        AND l.match_id = candidates.match_id AND l.source = candidates.source);
INSERT INTO candidates (query_id, match_id, kind, source, n_consistent, decision, reason,
        {", ".join(POSE_COLUMNS)}, information, loop_id, admitted_by)
    SELECT query_id, match_id, kind, source, 0, 'accepted', '', {", ".join(POSE_COLUMNS)},
        information, id, query_id
    FROM old_loops WHERE id NOT IN (SELECT loop_id FROM candidates WHERE loop_id IS NOT NULL);
DROP TABLE old_loops; DROP TABLE old_candidates; DROP TABLE old_regions;
DROP TABLE old_keyframes; DROP TABLE old_parameters;
{VIEWS}
"""

MIGRATABLE_VERSIONS = (2, 3, 4, 5, 6)
"""Older schema versions that can be migrated."""


def migrate(
    db: sqlite3.Connection, version: int, path: Path, *, in_place: bool
) -> sqlite3.Connection:
    """Migrate a map to the current schema version and return its connection.

    Without ``in_place`` the map is copied to memory and the copy migrated. Maps before version 4
    have no depth images: they can be read, but their places cannot be recognised.

    Raises
    ------
    MapError
        If it has triggers or other additions, or, with ``in_place``, is damaged.
    """
    views = (*_OLD_VIEWS, "loops") if version >= 4 else _OLD_VIEWS
    tables = {4: _TABLES_4, 5: _TABLES_5, 6: _TABLES_6}.get(version, _OLD)
    expected = {("table", name) for name in tables} | {("view", name) for name in views}
    statements = db.execute(STATEMENTS).fetchall()
    if added := find_additions(expected, map(tuple, statements)):
        raise MapError(f"{path}: found {added}")
    if not in_place:
        copy = sqlite3.connect(":memory:", isolation_level=None)
        prepare(copy)
        db.backup(copy)
        db.close()
        db = copy
    db.execute("PRAGMA foreign_keys = OFF")
    db.execute("PRAGMA legacy_alter_table = ON")
    try:
        if version >= 4:
            tables_added = (table for since, table in _ADDED if since > version)
            db.executescript("BEGIN;" + "".join(tables_added))
        else:
            _migrate_to_4(db, version, path, in_place=in_place)
        db.execute(f"PRAGMA user_version = {SCHEMA_VERSION}")
        db.execute("COMMIT")
    except BaseException:
        if db.in_transaction:
            db.execute("ROLLBACK")
        if not in_place:
            db.close()
        raise
    db.execute("PRAGMA legacy_alter_table = OFF")
    db.execute("PRAGMA foreign_keys = ON")
    return db


def _migrate_to_4(db: sqlite3.Connection, version: int, path: Path, *, in_place: bool) -> None:
    """Begin a transaction, and change the tables of version 2 or 3."""
    db.executescript("BEGIN;" + (_TO_3 if version == 2 else "") + _TO_4)
    for table in ("keyframes", "candidates", "regions"):
        _copy_rows(db, table)
    for statement in _LOOPS_TO_4.split(";"):
        db.execute(statement)
    for table in KEY_COLUMNS:
        update_checksums(db, table)
    if in_place:
        _check_rows(db, path)


def _copy_rows(db: sqlite3.Connection, table: str) -> None:
    """Copy the rows of an old table into the new one."""
    shared = [name for name in columns(db, f"old_{table}") if name in columns(db, table)]
    extra, of_extra = (", session", ", 0") if table == "keyframes" else ("", "")
    names = ", ".join(shared)
    db.execute(f"INSERT INTO {table} ({names}{extra}) SELECT {names}{of_extra} FROM old_{table}")


def _check_rows(db: sqlite3.Connection, path: Path) -> None:
    """Check everything before it gets checksums for good: old maps have none."""
    for table, key in KEY_COLUMNS.items():
        for row in db.execute(f"SELECT * FROM {table}"):
            if fault := find_fault(table, row):
                raise MapError(
                    f"{path}: found {table}, row {row[key]}, which {fault}, expected a whole map "
                    "to upgrade; slam-bof map recover copies the intact rows into a new map"
                )
