"""The tables of ``map.db``.

A map is one SQLite file, readable with the sqlite3 shell. Poses are columns ``tx ty tz`` in metres
and ``qx qy qz qw``; blobs are little-endian arrays. ``crc`` is the checksum of the other columns
of its row, as ``row_crc`` computes it, by which damaged rows are found.

=============== ===================================================================
table           columns
=============== ===================================================================
``sessions``    One row for each run of the map: ``id``; ``dataset``, ``sequence``; ``config``
                (YAML), ``seed``, ``version``; ``max_frames`` (null: all); ``state``, the JSON
                needed to resume after the newest keyframe; ``is_finished``.
``keyframes``   ``id``; ``session``; ``frame_index`` in the session; ``stamp_s``; ``segment``, a
                counter that increases when odometry was lost or restarted;
                ``odom_tx ... odom_qw`` (T_odom_camera, corrected by tracking);
                ``map_tx ... map_qw`` (T_map_camera, null until the session is finished);
                ``scene`` and ``scene_probability`` (null without a scene classifier);
                ``probabilities``, float64, in the order of the parameter ``classes``;
                ``words`` int32 and ``weights`` float32 of the bag of words; ``smoothed``,
                ``smoothed_probability`` and ``smoothed_probabilities``, the label that also
                uses the keyframes before and, once the session is finished, after;
                ``region``, the id of the room.
``views``       ``keyframe_id``; ``depth``, its subsampled depth image as a 16-bit PNG with
                ``per_m`` units per metre.
``constellations``
                How a keyframe was described for the search, so that it need not be described again:
                ``keyframe_id``; ``gravity``, float64 (3,), the direction down in the camera frame;
                ``describer``, a hash of the version and the parameters that found the contours;
                ``contours``, 38 bytes each (``bof.IndexedView``); ``weight`` of all of them.
                Without a row, as in older maps, a keyframe is described when the map is opened.
``frames``      Every frame up to the newest keyframe, and every frame of a finished session:
                ``id``, ``session``, ``frame_index``, ``stamp_s``; ``segment`` (-1: odometry was
                lost); ``T_odom_raw`` from odometry and ``T_odom_camera`` corrected by tracking,
                float64 (3, 4), of keyframes followed by the covariance (6, 6) of the step from
                the keyframe before, if it is known; ``T_view_camera`` for point clouds, null for
                depth images.
``candidates``  The audit trail, one row for each pair considered: ``id`` and the fields of
                ``slam_bof.types.Candidate``, null where not measured. ``decision`` is
                ``accepted``, ``rejected`` or ``held`` (waiting for loops that agree).
                Pairs that geometric verification accepts have ``tx ... qw`` (T_match_query)
                and ``information``, float64 (6, 6), rotation first. Those in the graph have
                ``loop_id``, their order of entry, and ``admitted_by``, the newest keyframe at
                that time. ``left_out_by`` is the session whose final optimisation left the
                loop out again.
``culled``      The keyframes that the map no longer searches, because others show the same:
                ``keyframe_id``; ``anchor_id``, the keyframe that its pose is fixed to;
                ``culled_by``, the newest keyframe at that time.
``odometry``    The state of the odometry after a recent keyframe of the newest session, to resume
                without repeating it; empty if the odometry cannot save it: ``name``;
                ``session`` and ``frame_index`` of the keyframe; ``value``, an array as a .npy file:
                ``skipped``, the indices of unusable frames of the data set before, or
                ``state/...``, an array of the odometry.
``regions``     Rooms: ``id``, ``label``, ``probability``, ``n_keyframes``; ``center_*``,
                ``low_*`` and ``high_*`` of the camera positions, in metres, in the map frame.
``parameters``  ``key`` and ``value``: ``classes``, the scene labels as a JSON list; ``camera``;
                ``model`` ...
=============== ===================================================================

The view ``loops`` lists the edges of the graph: ``id``, ``query_id``, ``match_id``, ``kind`` (loop
or covisibility), ``source`` (view, bag, proximity or pruned), ``tx ... qw`` and ``information``.
The views ``keyframe_labels`` and ``loop_audit`` show labels and candidates in readable form.
``PRAGMA user_version`` is the schema version.
"""

from __future__ import annotations

__all__ = [
    "APPLICATION_ID",
    "BOX_COLUMNS",
    "CONSTELLATIONS_TABLE",
    "CULLED_TABLE",
    "KEY_COLUMNS",
    "ODOMETRY_TABLE",
    "POSE_COLUMNS",
    "SCHEMA",
    "SCHEMA_VERSION",
    "SMOOTHED_COLUMNS",
]

SCHEMA_VERSION = 7
APPLICATION_ID = 0x424F464D
"""Marks a database as a map of slam_bof ("BOFM")."""

POSE_COLUMNS = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")

BOX_COLUMNS = tuple(f"{corner}_{axis}" for corner in ("center", "low", "high") for axis in "xyz")
"""Columns of the extent of a room."""

SMOOTHED_COLUMNS = {
    "smoothed": "TEXT",
    "smoothed_probability": "REAL",
    "smoothed_probabilities": "BLOB",
    "region": "INTEGER",
}
"""Columns of ``keyframes`` that were added with version 3."""

KEY_COLUMNS = {
    "sessions": "id",
    "keyframes": "id",
    "views": "keyframe_id",
    "constellations": "keyframe_id",
    "frames": "id",
    "candidates": "id",
    "culled": "keyframe_id",
    "odometry": "name",
    "regions": "id",
    "parameters": "key",
}
"""The tables, whose rows all have a ``crc``, and the column that identifies a row of each."""

CULLED_TABLE = """
CREATE TABLE culled (
    keyframe_id INTEGER PRIMARY KEY REFERENCES keyframes (id),
    anchor_id INTEGER NOT NULL REFERENCES keyframes (id),
    culled_by INTEGER NOT NULL REFERENCES keyframes (id),
    crc INTEGER
);
"""
"""Added with version 5."""

CONSTELLATIONS_TABLE = """
CREATE TABLE constellations (
    keyframe_id INTEGER PRIMARY KEY REFERENCES keyframes (id),
    gravity BLOB NOT NULL,
    describer TEXT NOT NULL,
    contours BLOB NOT NULL,
    weight REAL NOT NULL,
    crc INTEGER
);
"""
"""Added with version 6."""

ODOMETRY_TABLE = """
CREATE TABLE odometry (
    name TEXT PRIMARY KEY,
    session INTEGER NOT NULL REFERENCES sessions (id),
    frame_index INTEGER NOT NULL,
    value BLOB NOT NULL,
    crc INTEGER
);
"""
"""Added with version 7."""

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
    {", ".join(f"odom_{name} REAL NOT NULL" for name in POSE_COLUMNS)},
    {", ".join(f"map_{name} REAL" for name in POSE_COLUMNS)},
    scene TEXT,
    scene_probability REAL,
    probabilities BLOB,
    words BLOB NOT NULL,
    weights BLOB NOT NULL,
    {", ".join(f"{name} {kind}" for name, kind in SMOOTHED_COLUMNS.items())},
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
    {", ".join(f"{name} REAL" for name in POSE_COLUMNS)},
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
    {", ".join(f"{name} REAL NOT NULL" for name in BOX_COLUMNS)},
    crc INTEGER
);
{CULLED_TABLE}
{CONSTELLATIONS_TABLE}
{ODOMETRY_TABLE}
"""

VIEWS = f"""
CREATE VIEW loops AS
    SELECT loop_id AS id, query_id, match_id, kind, source, {", ".join(POSE_COLUMNS)}, information
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
