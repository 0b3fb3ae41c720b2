"""Keyframes dropped from a map at rest."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.slam import History
from slam_bof.store.map_components import parts_of
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import INSERT_CANDIDATE, candidate_row, edge_row
from slam_bof.store.schema import CHECKED, POSE
from slam_bof.store.sqlite import sign
from slam_bof.types import Candidate, Loop

__all__ = ["drop_keyframes", "prune_map", "redundant"]

PRUNED = "pruned"
"""The ``source`` of loops that stand for those of keyframes which are gone."""

REFERENCES = (
    ("views", "keyframe_id"),
    ("candidates", "query_id"),
    ("candidates", "match_id"),
    ("candidates", "admitted_by"),
    ("keyframes", "id"),
)
"""Where the ids of keyframes are."""


def prune_map(path: Path | str, choose: Callable[[MapStore], Collection[int]]) -> int:
    """Drop keyframes from a map, in one transaction; return how many.

    Where the others are stays what it is: what the graph came to becomes their odometry, so that
    they do not need the loops of those that are gone. Ids are counted anew.

    Parameters
    ----------
    path
        The map.
    choose
        Says of a map which keyframes to drop, such as ``redundant``.

    Raises
    ------
    MapError
        If the map's last run was interrupted.
    """
    with MapStore.open(path, read_only=False) as store:
        for session in store.sessions():
            if not session.is_finished:
                raise MapError(
                    f"{path}: found that the run of {session.sequence} was interrupted, "
                    "expected a finished one: resume it first"
                )
        dropped = set(choose(store))
        if not dropped:
            return 0
        parts = parts_of(store)
        kept = [k for k in range(len(parts)) if k not in dropped]
        with store.transaction() as db:
            _settle(store, db)
            drop_keyframes(db, dropped)
            _tie(store, db, parts[kept])
        store.vacuum()
    return len(dropped)


def redundant(store: MapStore, *, distance_m: float, angle_rad: float) -> list[int]:
    """Return keyframes that stand where an older one does that is kept, nearer and less turned."""
    T_map_camera, parts = store.map_poses(), parts_of(store)
    kept: list[int] = []
    dropped: list[int] = []
    for id_, T in enumerate(T_map_camera):
        others = [k for k in kept if parts[k] == parts[id_]]
        motions = se3.inverse(T_map_camera[others]) @ T
        near = np.linalg.norm(motions[:, :3, 3], axis=1) < distance_m
        near &= np.array(se3.rotation_angle(motions)) < angle_rad
        (dropped if near.any() else kept).append(id_)
    return dropped


def drop_keyframes(db: sqlite3.Connection, dropped: Collection[int]) -> None:
    """Delete keyframes with all that names them, count the others anew, and sign all rows.

    Runs within a transaction.
    """
    db.execute("PRAGMA defer_foreign_keys = ON")
    db.execute("CREATE TEMP TABLE gone (id INTEGER PRIMARY KEY)")
    db.executemany("INSERT INTO gone VALUES (?)", [(int(id_),) for id_ in sorted(dropped)])
    # A loop that a dropped keyframe admitted is admitted by the next one that is kept.
    db.execute(
        "UPDATE candidates SET admitted_by = (SELECT min(id) FROM keyframes"
        " WHERE id > admitted_by AND id NOT IN gone) WHERE admitted_by IN gone"
    )
    known = "(SELECT id FROM keyframes WHERE id NOT IN gone)"
    db.execute(
        f"DELETE FROM candidates WHERE query_id NOT IN {known} OR match_id NOT IN {known}"
        " OR (loop_id IS NOT NULL AND admitted_by IS NULL)"
    )
    db.execute(f"DELETE FROM views WHERE keyframe_id NOT IN {known}")
    db.execute("DELETE FROM keyframes WHERE id IN gone")
    db.execute("DELETE FROM frames WHERE session NOT IN (SELECT session FROM keyframes)")
    db.execute("DROP TABLE gone")
    _count_anew(db)
    db.execute(
        "UPDATE regions SET n_keyframes ="
        " (SELECT count(*) FROM keyframes WHERE region = regions.id)"
    )
    db.execute("DELETE FROM regions WHERE n_keyframes = 0")
    for table in CHECKED:
        sign(db, table)


def _count_anew(db: sqlite3.Connection) -> None:
    """Let the ids of keyframes be 0, 1, 2 ... in the order they have."""
    db.execute("CREATE TEMP TABLE anew (old INTEGER PRIMARY KEY, new INTEGER)")
    db.execute("INSERT INTO anew SELECT id, row_number() OVER (ORDER BY id) - 1 FROM keyframes")
    for table, column in REFERENCES:
        # By way of negative numbers, which nobody has.
        db.execute(
            f"UPDATE {table} SET {column} = -1 - (SELECT new FROM anew WHERE old = {column})"
            f" WHERE {column} IS NOT NULL"
        )
        db.execute(f"UPDATE {table} SET {column} = -1 - {column} WHERE {column} < 0")
    db.execute("DROP TABLE anew")


def _settle(store: MapStore, db: sqlite3.Connection) -> None:
    """Let the map's poses be what odometry says, of keyframes and of all frames."""
    keyframes, T_map_camera = store.keyframes(), store.map_poses()
    for session in store.sessions():
        own = [k for k, keyframe in enumerate(keyframes) if keyframe.session == session.id]
        frames = [replace(frame, T_view_camera=None) for frame in store.frames(session.id)]
        if not own or not frames:
            continue
        settled = History(frames).trajectory([keyframes[k] for k in own], T_map_camera[own])
        db.executemany(
            "UPDATE frames SET T_odom_camera = ? WHERE session = ? AND frame_index = ?",
            [
                (np.ascontiguousarray(T[:3]).astype("<f8").tobytes(), session.id, index)
                for index, T in enumerate(settled.poses)
            ],
        )
    db.execute(f"UPDATE keyframes SET {', '.join(f'odom_{name} = map_{name}' for name in POSE)}")
    db.execute("UPDATE sessions SET state = NULL")


def _tie(store: MapStore, db: sqlite3.Connection, parts: NDArray[np.int64]) -> None:
    """Tie each segment to the nearest keyframe of an older one of its part, as loops had it."""
    keyframes, T_map_camera = store.keyframes(), store.map_poses()
    segments = np.array([keyframe.segment for keyframe in keyframes])
    ((next_id,),) = db.execute("SELECT coalesce(max(loop_id) + 1, 0) FROM candidates")
    for segment in np.unique(segments):
        query = int(np.flatnonzero(segments == segment)[0])
        older = np.flatnonzero((parts[:query] == parts[query]) & (segments[:query] != segment))
        if not len(older):
            continue
        apart_m = np.linalg.norm(T_map_camera[older, :3, 3] - T_map_camera[query, :3, 3], axis=1)
        match = int(older[apart_m.argmin()])
        T = se3.inverse(T_map_camera[match]) @ T_map_camera[query]
        loop = Loop(query, match, T, np.eye(6), "loop", PRUNED)
        candidate = Candidate(query, match, PRUNED, decision="accepted")
        edge = edge_row(loop, loop_id=next_id, admitted_by=query)
        db.execute(INSERT_CANDIDATE, candidate_row(candidate, edge))
        next_id += 1
    sign(db, "candidates", "source = ?", PRUNED)
