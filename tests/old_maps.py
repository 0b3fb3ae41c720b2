"""Maps as versions 2 and 3 of the layout had them."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import numpy as np

__all__ = ["write_old_map"]

SCHEMA_3 = """BEGIN;
CREATE TABLE parameters (key TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE keyframes (
    id INTEGER PRIMARY KEY,
    frame_index INTEGER NOT NULL UNIQUE,
    stamp_s REAL NOT NULL,
    segment INTEGER NOT NULL,
    odom_tx REAL NOT NULL, odom_ty REAL NOT NULL, odom_tz REAL NOT NULL, odom_qx REAL NOT NULL,
    odom_qy REAL NOT NULL, odom_qz REAL NOT NULL, odom_qw REAL NOT NULL,
    map_tx REAL, map_ty REAL, map_tz REAL, map_qx REAL, map_qy REAL, map_qz REAL, map_qw REAL,
    scene TEXT,
    scene_probability REAL,
    probabilities BLOB,
    words BLOB NOT NULL,
    weights BLOB NOT NULL,
    cloud BLOB,
    smoothed TEXT, smoothed_probability REAL, smoothed_probabilities BLOB, region INTEGER
);
CREATE TABLE loops (
    id INTEGER PRIMARY KEY,
    query_id INTEGER NOT NULL REFERENCES keyframes (id),
    match_id INTEGER NOT NULL REFERENCES keyframes (id),
    kind TEXT NOT NULL,
    source TEXT NOT NULL,
    tx REAL NOT NULL, ty REAL NOT NULL, tz REAL NOT NULL, qx REAL NOT NULL, qy REAL NOT NULL,
    qz REAL NOT NULL, qw REAL NOT NULL,
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

CREATE TABLE regions (
    id INTEGER PRIMARY KEY,
    label TEXT NOT NULL,
    probability REAL NOT NULL,
    n_keyframes INTEGER NOT NULL,
    center_x REAL NOT NULL, center_y REAL NOT NULL, center_z REAL NOT NULL,
    low_x REAL NOT NULL, low_y REAL NOT NULL, low_z REAL NOT NULL, high_x REAL NOT NULL,
    high_y REAL NOT NULL, high_z REAL NOT NULL
);
CREATE VIEW keyframe_labels AS
    SELECT id, frame_index, stamp_s, scene, round(scene_probability, 3) AS probability,
        smoothed, round(smoothed_probability, 3) AS smoothed_probability, region,
        round(coalesce(map_tx, odom_tx), 3) AS x_m,
        round(coalesce(map_ty, odom_ty), 3) AS y_m,
        round(coalesce(map_tz, odom_tz), 3) AS z_m,
        (SELECT count(*) FROM loops WHERE query_id = keyframes.id AND kind = 'loop') AS n_loops
    FROM keyframes ORDER BY id;
PRAGMA user_version = 3;

PRAGMA application_id = 1112491597;
COMMIT;
"""

TO_2 = """
DROP VIEW keyframe_labels;
DROP TABLE regions;
ALTER TABLE keyframes DROP COLUMN smoothed;
ALTER TABLE keyframes DROP COLUMN smoothed_probability;
ALTER TABLE keyframes DROP COLUMN smoothed_probabilities;
ALTER TABLE keyframes DROP COLUMN region;
CREATE VIEW keyframe_labels AS SELECT id FROM keyframes;
PRAGMA user_version = 2;
"""

POSE = (0.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


def write_old_map(path: Path, version: int) -> None:
    """Write a map of two keyframes with a loop between them that has two candidates."""
    db = sqlite3.connect(path)
    db.executescript(SCHEMA_3)
    for id_ in range(2):
        names = "id, frame_index, stamp_s, segment, words, weights, odom_tx, odom_ty, odom_tz, "
        names += "odom_qx, odom_qy, odom_qz, odom_qw"
        values = (id_, 5 * id_, id_ / 6, 0, b"", b"", *POSE)
        marks = ", ".join("?" * len(values))
        db.execute(f"INSERT INTO keyframes ({names}) VALUES ({marks})", values)
    for source, decision in (("view", "accepted"), ("proximity", "rejected")):
        db.execute(
            "INSERT INTO candidates (query_id, match_id, source, kind, n_consistent, decision,"
            " reason) VALUES (1, 0, ?, 'loop', 1, ?, '')",
            (source, decision),
        )
    db.execute(
        "INSERT INTO loops VALUES (7, 1, 0, 'loop', 'view', ?, ?, ?, ?, ?, ?, ?, ?)",
        (*POSE, np.eye(6).tobytes()),
    )
    db.execute("INSERT INTO parameters VALUES ('sequence', 'flat/seq-01')")
    if version == 2:
        db.executescript(TO_2)
    db.commit()
    db.close()
