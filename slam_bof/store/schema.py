"""The layout of ``map.db``, how it is opened, and what its errors mean.

One SQLite file, readable with the sqlite3 shell. Poses are columns ``tx ty tz`` in metres and
``qx qy qz qw``; blobs are little-endian arrays. ``crc`` is of the other columns of its row, as
``row_crc`` computes it, so that damage is noticed and named.

=============== ===================================================================
table           columns
=============== ===================================================================
``sessions``    one for each run that the map is of: ``id``; ``dataset``,
                ``sequence``; ``config`` (YAML), ``seed``, ``version``,
                ``max_frames`` (null: all); ``state`` (JSON), what else it takes to
                resume after the newest keyframe; ``is_finished``
``keyframes``   ``id``; ``session``; ``frame_index`` in it; ``stamp_s``; ``segment``, which
                counts how often odometry was lost or another began; ``odom_tx ... odom_qw``
                (T_odom_camera, as tracking has mended it); ``map_tx ... map_qw``
                (T_map_camera, null until the session is finished); ``scene`` and
                ``scene_probability``, null without a scene classifier;
                ``probabilities`` float64, in the order of the parameter ``classes``;
                ``words`` int32 and ``weights`` float32, the bag;
                ``smoothed``, ``smoothed_probability``, ``smoothed_probabilities``,
                the label by the keyframes around as well (by those before until the
                session is finished); ``region`` it stands in
``views``       ``keyframe_id``; ``depth``, every few pixels of its depth image as a 16-bit
                PNG, in steps of which ``per_m`` make a metre
``frames``      ``id``; every frame up to the newest keyframe (up to the last once the session is
                finished): ``session``, ``frame_index``, ``stamp_s``, ``segment`` (-1: odometry
                lost); ``T_odom_raw`` and ``T_odom_camera`` float64 (3, 4), by odometry and as
                tracking has mended it, of keyframes followed by float64 (6, 6), the
                covariance of the step from the keyframe before; ``T_view_camera`` of
                point clouds, else null
``candidates``  the audit trail, every pair considered: ``id`` and the fields of
                ``slam_bof.types.Candidate``, null where not measured; ``decision``
                is ``accepted``, ``rejected`` or ``held`` (never agreed with).
                Of those that geometry accepts ``tx ... qw`` (T_match_query) and
                ``information`` float64 (6, 6), rotation first; of those that entered the
                graph ``loop_id``, in that order, and ``admitted_by``, the newest keyframe then;
                ``left_out_by`` the session at whose end they were left out again
``regions``     rooms: ``id``, ``label``, ``probability``, ``n_keyframes``;
                ``center_*``, ``low_*`` and ``high_*`` of where the camera was, in
                metres in the map frame
``parameters``  ``key``, ``value``: ``classes``, the scene labels as a JSON list, ``camera``,
                ``model`` ...
=============== ===================================================================

The view ``loops`` has the graph's edges: ``id``, ``query_id``, ``match_id``, ``kind`` (loop or
covisibility), ``source`` (view, bag or proximity), ``tx ... qw`` and ``information``. The views
``keyframe_labels`` and ``loop_audit`` show labels and candidates for people to read.
``PRAGMA user_version`` is the version of this layout.
"""

from __future__ import annotations

__all__ = ["APPLICATION_ID", "BOX", "CHECKED", "POSE", "SCHEMA", "SCHEMA_VERSION", "SMOOTHED"]

SCHEMA_VERSION = 4
APPLICATION_ID = 0x424F464D
"""Tells a map from other programs' databases ("BOFM")."""

POSE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")

BOX = tuple(f"{corner}_{axis}" for corner in ("center", "low", "high") for axis in "xyz")
"""Columns of a region's extent."""


SMOOTHED = {
    "smoothed": "TEXT",
    "smoothed_probability": "REAL",
    "smoothed_probabilities": "BLOB",
    "region": "INTEGER",
}
"""Columns of ``keyframes`` since version 3."""

CHECKED = {
    "sessions": "id",
    "keyframes": "id",
    "views": "keyframe_id",
    "frames": "id",
    "candidates": "id",
    "regions": "id",
    "parameters": "key",
}
"""The tables whose rows have a ``crc``, and what each row is called by."""

TABLES = f"""
CREATE TABLE parameters (key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER);
CREATE TABLE sessions (
    id INTEGER PRIMARY KEY,
    dataset TEXT NOT NULL,
    sequence TEXT NOT NULL,
    config TEXT NOT NULL,
    seed INTEGER NOT NULL,
    version TEXT NOT NULL,
    max_frames INTEGER,
    state TEXT,
    is_finished INTEGER NOT NULL DEFAULT 0,
    crc INTEGER
);
CREATE TABLE keyframes (
    id INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions (id),
    frame_index INTEGER NOT NULL,
    stamp_s REAL NOT NULL,
    segment INTEGER NOT NULL,
    {", ".join(f"odom_{name} REAL NOT NULL" for name in POSE)},
    {", ".join(f"map_{name} REAL" for name in POSE)},
    scene TEXT,
    scene_probability REAL,
    probabilities BLOB,
    words BLOB NOT NULL,
    weights BLOB NOT NULL,
    {", ".join(f"{name} {kind}" for name, kind in SMOOTHED.items())},
    crc INTEGER,
    UNIQUE (session, frame_index)
);
CREATE TABLE views (
    keyframe_id INTEGER PRIMARY KEY REFERENCES keyframes (id),
    per_m INTEGER NOT NULL,
    depth BLOB NOT NULL,
    crc INTEGER
);
CREATE TABLE frames (
    id INTEGER PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions (id),
    frame_index INTEGER NOT NULL,
    stamp_s REAL NOT NULL,
    segment INTEGER NOT NULL,
    T_odom_raw BLOB NOT NULL,
    T_odom_camera BLOB NOT NULL,
    T_view_camera BLOB,
    crc INTEGER,
    UNIQUE (session, frame_index)
);
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
    reason TEXT NOT NULL,
    {", ".join(f"{name} REAL" for name in POSE)},
    information BLOB,
    loop_id INTEGER UNIQUE,
    admitted_by INTEGER REFERENCES keyframes (id),
    left_out_by INTEGER REFERENCES sessions (id),
    crc INTEGER
);
CREATE INDEX candidates_by_query ON candidates (query_id);
CREATE INDEX candidates_by_match ON candidates (match_id);
CREATE INDEX candidates_by_admitted ON candidates (admitted_by);
CREATE TABLE regions (
    id INTEGER PRIMARY KEY,
    label TEXT NOT NULL,
    probability REAL NOT NULL,
    n_keyframes INTEGER NOT NULL,
    {", ".join(f"{name} REAL NOT NULL" for name in BOX)},
    crc INTEGER
);
"""

VIEWS = f"""
CREATE VIEW loops AS
    SELECT loop_id AS id, query_id, match_id, kind, source, {", ".join(POSE)}, information
    FROM candidates WHERE decision = 'accepted' AND loop_id IS NOT NULL ORDER BY loop_id;
CREATE VIEW loop_audit AS
    SELECT query_id, match_id, q.stamp_s AS query_stamp_s, m.stamp_s AS match_stamp_s,
        kind, source, decision, reason, round(score, 4) AS score, round(eta, 4) AS eta,
        round(scene_agreement, 3) AS scene_agreement, n_consistent,
        round(overlap, 3) AS overlap, round(rmse_m, 4) AS rmse_m
    FROM candidates
        JOIN keyframes AS q ON q.id = query_id
        JOIN keyframes AS m ON m.id = match_id
    ORDER BY candidates.id;
CREATE VIEW keyframe_labels AS
    SELECT id, session, frame_index, stamp_s, scene, round(scene_probability, 3) AS probability,
        smoothed, round(smoothed_probability, 3) AS smoothed_probability, region,
        round(coalesce(map_tx, odom_tx), 3) AS x_m,
        round(coalesce(map_ty, odom_ty), 3) AS y_m,
        round(coalesce(map_tz, odom_tz), 3) AS z_m,
        (SELECT count(*) FROM loops WHERE query_id = keyframes.id AND kind = 'loop') AS n_loops
    FROM keyframes ORDER BY id;
"""

SCHEMA = f"""
BEGIN;
{TABLES}
{VIEWS}
PRAGMA application_id = {APPLICATION_ID};
PRAGMA user_version = {SCHEMA_VERSION};
COMMIT;
"""
