"""Removal of keyframes from a finished map."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable, Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.errors import MapError
from slam_bof.geometry import se3
from slam_bof.slam import FrameHistory
from slam_bof.store.integrity import require_intact
from slam_bof.store.map_components import components_of
from slam_bof.store.map_store import MapStore
from slam_bof.store.row_codec import INSERT_CANDIDATE, encode_candidate, encode_edge
from slam_bof.store.schema import KEY_COLUMNS, POSE_COLUMNS
from slam_bof.store.sqlite import update_checksums
from slam_bof.types import Candidate, CandidateSource, Decision, EdgeKind, Loop

__all__ = ["drop_keyframes", "find_redundant_keyframes", "prune_map"]

REFERENCES = (
    ("views", "keyframe_id"),
    ("constellations", "keyframe_id"),
    ("candidates", "query_id"),
    ("candidates", "match_id"),
    ("candidates", "admitted_by"),
    ("culled", "keyframe_id"),
    ("culled", "anchor_id"),
    ("culled", "culled_by"),
    ("keyframes", "id"),
)
"""The columns that hold ids of keyframes."""


def prune_map(path: Path | str, choose: Callable[[MapStore], Collection[int]]) -> int:
    """Drop keyframes from a map, in one transaction; return how many were dropped.

    The poses of the other keyframes do not change: their optimised poses become their odometry,
    so that the loops of dropped keyframes are no longer needed. The keyframes are renumbered.

    Parameters
    ----------
    path
        The map.
    choose
        Returns the ids of the keyframes to drop, such as ``find_redundant_keyframes``.

    Raises
    ------
    MapError
        If the map is damaged, or its last run was interrupted; then nothing is dropped. Or if the
        file cannot be made smaller, such as on a full disk, after the keyframes were dropped.
    """
    require_intact(path)
    with MapStore.open(path, read_only=False) as store:
        for session in store.sessions():
            if not session.is_finished:
                raise MapError(
                    f"{path}: found an interrupted run of {session.sequence}, "
                    f"expected a finished one: resume it, or slam-bof map finish {path}"
                )
        dropped = set(choose(store))
        if not dropped:
            return 0
        components = components_of(store)
        kept = [k for k in range(len(components)) if k not in dropped]
        with store.transaction() as db:
            _freeze_map_poses(store, db)
            drop_keyframes(db, dropped)
            _link_segments(store, db, components[kept])
        try:
            store.vacuum()
        except MapError as error:
            raise MapError(
                f"{error}; {len(dropped)} of {len(components)} keyframes are dropped all the "
                f"same, but the file is not smaller yet: slam-bof map vacuum {path}"
            ) from error
    return len(dropped)


def find_redundant_keyframes(store: MapStore, *, distance_m: float, angle_rad: float) -> list[int]:
    """Return the ids of keyframes close to an older keyframe that is kept.

    Parameters
    ----------
    store
        The map.
    distance_m, angle_rad
        A keyframe is redundant if both its distance to the older one and its rotation from it
        are smaller than these, and both are in one component.
    """
    T_map_camera, components = store.map_poses(), components_of(store)
    is_kept = np.zeros(len(components), bool)
    for id_, T in enumerate(T_map_camera):
        distances_m = np.linalg.norm(T_map_camera[:id_, :3, 3] - T[:3, 3], axis=1)
        is_near = is_kept[:id_] & (components[:id_] == components[id_]) & (distances_m < distance_m)
        motions = se3.inverse(T_map_camera[:id_][is_near]) @ T
        is_kept[id_] = not np.any(np.array(se3.rotation_angle(motions)) < angle_rad)
    return np.flatnonzero(~is_kept).tolist()


def drop_keyframes(db: sqlite3.Connection, dropped: Collection[int]) -> None:
    """Delete keyframes and the rows that refer to them, renumber the others, update checksums.

    It must run within a transaction.
    """
    db.execute("PRAGMA defer_foreign_keys = ON")
    db.execute("CREATE TEMP TABLE gone (id INTEGER PRIMARY KEY)")
    db.executemany("INSERT INTO gone VALUES (?)", [(int(id_),) for id_ in sorted(dropped)])
    # A loop admitted with a dropped keyframe counts as admitted with the next one that is kept.
    db.execute(
        "UPDATE candidates SET admitted_by = (SELECT min(id) FROM keyframes"
        " WHERE id > admitted_by AND id NOT IN gone) WHERE admitted_by IN gone"
    )
    db.execute(
        "UPDATE culled SET culled_by = (SELECT min(id) FROM keyframes"
        " WHERE id > culled_by AND id NOT IN gone) WHERE culled_by IN gone"
        " AND EXISTS (SELECT 1 FROM keyframes WHERE id > culled_by AND id NOT IN gone)"
    )
    known = "(SELECT id FROM keyframes WHERE id NOT IN gone)"
    db.execute(
        f"DELETE FROM candidates WHERE query_id NOT IN {known} OR match_id NOT IN {known}"
        " OR (loop_id IS NOT NULL AND admitted_by IS NULL)"
    )
    db.execute(
        f"DELETE FROM culled WHERE keyframe_id NOT IN {known} OR anchor_id NOT IN {known}"
        f" OR culled_by NOT IN {known}"
    )
    for table in ("views", "constellations"):
        db.execute(f"DELETE FROM {table} WHERE keyframe_id NOT IN {known}")
    db.execute("DELETE FROM odometry")
    db.execute("DELETE FROM keyframes WHERE id IN gone")
    db.execute("DELETE FROM frames WHERE session NOT IN (SELECT session FROM keyframes)")
    db.execute("DROP TABLE gone")
    _renumber_keyframes(db)
    db.execute(
        "UPDATE regions SET n_keyframes ="
        " (SELECT count(*) FROM keyframes WHERE region = regions.id)"
    )
    db.execute("DELETE FROM regions WHERE n_keyframes = 0")
    for table in KEY_COLUMNS:
        update_checksums(db, table)


def _renumber_keyframes(db: sqlite3.Connection) -> None:
    """Renumber the keyframes 0, 1, 2 ... in their present order."""
    db.execute("CREATE TEMP TABLE renumbered (old INTEGER PRIMARY KEY, new INTEGER)")
    db.execute(
        "INSERT INTO renumbered SELECT id, row_number() OVER (ORDER BY id) - 1 FROM keyframes"
    )
    for table, column in REFERENCES:
        # By way of negative numbers, so that no new id equals an old one that is still in use.
        db.execute(
            f"UPDATE {table} SET {column} = -1 - (SELECT new FROM renumbered WHERE old = {column})"
            f" WHERE {column} IS NOT NULL"
        )
        db.execute(f"UPDATE {table} SET {column} = -1 - {column} WHERE {column} < 0")
    db.execute("DROP TABLE renumbered")


def _freeze_map_poses(store: MapStore, db: sqlite3.Connection) -> None:
    """Replace the odometry of keyframes and of all frames by their optimised poses."""
    keyframes, T_map_camera = store.keyframes(), store.map_poses()
    for session in store.sessions():
        own = [k for k, keyframe in enumerate(keyframes) if keyframe.session == session.id]
        frames = [replace(frame, T_view_camera=None) for frame in store.frames(session.id)]
        if not own or not frames:
            continue
        frozen = FrameHistory(frames).trajectory([keyframes[k] for k in own], T_map_camera[own])
        db.executemany(
            "UPDATE frames SET T_odom_camera = ? WHERE session = ? AND frame_index = ?",
            [
                (np.ascontiguousarray(T[:3]).astype("<f8").tobytes(), session.id, index)
                for index, T in enumerate(frozen.poses)
            ],
        )
    db.execute(
        f"UPDATE keyframes SET {', '.join(f'odom_{name} = map_{name}' for name in POSE_COLUMNS)}"
    )
    db.execute("UPDATE sessions SET state = NULL")


def _link_segments(store: MapStore, db: sqlite3.Connection, components: NDArray[np.int64]) -> None:
    """Add a loop from each segment to the nearest older keyframe of its component.

    Without it, segments that only the loops of dropped keyframes connected would fall apart.
    """
    keyframes, T_map_camera = store.keyframes(), store.map_poses()
    segments = np.array([keyframe.segment for keyframe in keyframes])
    ((next_id,),) = db.execute("SELECT coalesce(max(loop_id) + 1, 0) FROM candidates")
    for segment in np.unique(segments):
        query = int(np.flatnonzero(segments == segment)[0])
        is_own = components[:query] == components[query]
        older = np.flatnonzero(is_own & (segments[:query] != segment))
        if not len(older):
            continue
        offsets_m = T_map_camera[older, :3, 3] - T_map_camera[query, :3, 3]
        match = int(older[np.linalg.norm(offsets_m, axis=1).argmin()])
        T = se3.inverse(T_map_camera[match]) @ T_map_camera[query]
        loop = Loop(query, match, T, np.eye(6), EdgeKind.LOOP, CandidateSource.PRUNED)
        candidate = Candidate(query, match, CandidateSource.PRUNED, decision=Decision.ACCEPTED)
        edge = encode_edge(loop, loop_id=next_id, admitted_by=query)
        db.execute(INSERT_CANDIDATE, encode_candidate(candidate, edge))
        next_id += 1
    update_checksums(db, "candidates", "source = ?", CandidateSource.PRUNED)
