"""The layout of ``map.db``, how it is opened, and what its errors mean.

One SQLite file, readable with the sqlite3 shell. Poses are columns ``tx ty tz`` in metres and
``qx qy qz qw``; blobs are little-endian arrays.

=============== ===================================================================
table           columns
=============== ===================================================================
``keyframes``   ``id``; ``frame_index``; ``stamp_s``; ``segment``, which counts how
                often odometry was lost; ``odom_tx ... odom_qw`` (T_odom_camera, as
                tracking has mended it); ``map_tx ... map_qw`` (T_map_camera, null until the
                run is finished); ``scene`` and ``scene_probability``, null without
                a scene classifier; ``probabilities`` float64, in the order of the
                parameter ``classes``; ``words`` int32 and ``weights`` float32, the
                bag; ``cloud`` float32 (N, 3) points_camera, or null;
                ``smoothed``, ``smoothed_probability``, ``smoothed_probabilities``,
                the label by the keyframes around as well (by those before until the
                run is finished); ``region`` it stands in
``regions``     rooms: ``id``, ``label``, ``probability``, ``n_keyframes``;
                ``center_*``, ``low_*`` and ``high_*`` of where the camera was, in
                metres in the map frame
``loops``       ``id``; ``query_id`` and ``match_id``, keyframes; ``kind`` (loop or
                covisibility); ``source`` (view, bag or proximity); ``tx ... qw``
                (T_match_query); ``information`` float64 (6, 6), rotation first
``candidates``  the audit trail, every pair considered: ``id`` and the fields of
                ``slam_bof.types.Candidate``, null where not measured; ``decision``
                is ``accepted``, ``rejected`` or ``held`` (never agreed with)
``parameters``  ``key``, ``value``: configuration, seed, versions, data set ... and
                ``classes``, the scene labels as a JSON list
=============== ===================================================================

The views ``keyframe_labels`` and ``loop_audit`` show the same for people to read.
``PRAGMA user_version`` is the version of this layout.
"""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slam_bof.errors import MapError

__all__ = [
    "APPLICATION_ID",
    "BOX",
    "POSE",
    "SCHEMA",
    "SCHEMA_VERSION",
    "SMOOTHED",
    "UPGRADES",
    "connect",
    "naming_errors",
    "upgrade",
]

SCHEMA_VERSION = 3
APPLICATION_ID = 0x424F464D
"""Tells a map from other programs' databases ("BOFM")."""

POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")

BOX = tuple(f"{corner}_{axis}" for corner in ("center", "low", "high") for axis in "xyz")
"""Columns of a region's extent."""

BUSY_TIMEOUT_S = 5.0

SMOOTHED = {
    "smoothed": "TEXT",
    "smoothed_probability": "REAL",
    "smoothed_probabilities": "BLOB",
    "region": "INTEGER",
}
"""Columns of ``keyframes`` since version 3."""

_REGIONS = f"""
CREATE TABLE regions (
    id INTEGER PRIMARY KEY,
    label TEXT NOT NULL,
    probability REAL NOT NULL,
    n_keyframes INTEGER NOT NULL,
    {", ".join(f"{name} REAL NOT NULL" for name in BOX)}
);
CREATE VIEW keyframe_labels AS
    SELECT id, frame_index, stamp_s, scene, round(scene_probability, 3) AS probability,
        smoothed, round(smoothed_probability, 3) AS smoothed_probability, region,
        round(coalesce(map_tx, odom_tx), 3) AS x_m,
        round(coalesce(map_ty, odom_ty), 3) AS y_m,
        round(coalesce(map_tz, odom_tz), 3) AS z_m,
        (SELECT count(*) FROM loops WHERE query_id = keyframes.id AND kind = 'loop') AS n_loops
    FROM keyframes ORDER BY id;
PRAGMA user_version = {SCHEMA_VERSION};
"""

SCHEMA = f"""
BEGIN;
CREATE TABLE parameters (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE keyframes (
    id INTEGER PRIMARY KEY,
    frame_index INTEGER NOT NULL UNIQUE,
    stamp_s REAL NOT NULL,
    segment INTEGER NOT NULL,
    {", ".join(f"odom_{name} REAL NOT NULL" for name in POSE)},
    {", ".join(f"map_{name} REAL" for name in POSE)},
    scene TEXT,
    scene_probability REAL,
    probabilities BLOB,
    words BLOB NOT NULL,
    weights BLOB NOT NULL,
    cloud BLOB,
    {", ".join(f"{name} {kind}" for name, kind in SMOOTHED.items())}
);
CREATE TABLE loops (
    id INTEGER PRIMARY KEY,
    query_id INTEGER NOT NULL REFERENCES keyframes (id),
    match_id INTEGER NOT NULL REFERENCES keyframes (id),
    kind TEXT NOT NULL,
    source TEXT NOT NULL,
    {", ".join(f"{name} REAL NOT NULL" for name in POSE)},
    information BLOB NOT NULL
);
CREATE INDEX loops_by_query ON loops (query_id);
CREATE TABLE candidates (
    id INTEGER PRIMARY KEY,
    query_id INTEGER NOT NULL REFERENCES keyframes (id),
    match_id INTEGER NOT NULL REFERENCES keyframes (id),
    source TEXT NOT NULL,
    kind TEXT NOT NULL,
    score REAL,
    normaliser REAL,
    eta REAL,
    scene_agreement REAL,
    n_consistent INTEGER NOT NULL,
    overlap REAL,
    rmse_m REAL,
    decision TEXT NOT NULL,
    reason TEXT NOT NULL
);
CREATE INDEX candidates_by_query ON candidates (query_id);
CREATE VIEW loop_audit AS
    SELECT query_id, match_id, q.stamp_s AS query_stamp_s, m.stamp_s AS match_stamp_s,
        kind, source, decision, reason, round(score, 4) AS score, round(eta, 4) AS eta,
        round(scene_agreement, 3) AS scene_agreement, n_consistent,
        round(overlap, 3) AS overlap, round(rmse_m, 4) AS rmse_m
    FROM candidates
        JOIN keyframes AS q ON q.id = query_id
        JOIN keyframes AS m ON m.id = match_id
    ORDER BY candidates.id;
{_REGIONS}
PRAGMA application_id = {APPLICATION_ID};
COMMIT;
"""

UPGRADES = {
    2: f"""
BEGIN;
{"".join(f"ALTER TABLE keyframes ADD COLUMN {name} {kind};" for name, kind in SMOOTHED.items())}
DROP VIEW keyframe_labels;
{_REGIONS}
COMMIT;
""",
}
"""By the version that a map is of, what makes it one of this version."""

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

    Transactions are explicit (``BEGIN``); rows can be indexed by column name.
    """
    uri = f"{path.resolve().as_uri()}?mode={mode}"
    folder, wal = path.resolve().parent, Path(f"{path}-wal")
    if mode == "ro" and not wal.exists() and not os.access(folder, os.W_OK):
        # SQLite wants to put its lock files beside; on read-only media nothing can change.
        uri += "&immutable=1"
    db = sqlite3.connect(uri, timeout=BUSY_TIMEOUT_S, isolation_level=None, uri=True)
    db.row_factory = sqlite3.Row
    db.execute("PRAGMA foreign_keys = ON")
    db.execute("PRAGMA synchronous = NORMAL")
    return db


def upgrade(db: sqlite3.Connection, version: int, *, in_place: bool) -> sqlite3.Connection:
    """Return a map of an older version as one of this: itself, or a copy of it in memory."""
    if not in_place:
        copy = sqlite3.connect(":memory:", isolation_level=None)
        copy.row_factory = sqlite3.Row
        db.backup(copy)
        db.close()
        db = copy
    db.executescript(UPGRADES[version])
    return db


@contextmanager
def naming_errors(path: Path) -> Iterator[None]:
    """Turn what SQLite reports of a file into one line; leave what is a bug alone.

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
        if found is None:
            raise
        raise MapError(f"{path}: {found}") from error
