"""Recovery of a damaged map: its intact rows are copied into a new map."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from slam_bof.errors import ConfigError, MapError
from slam_bof.slam import config as configs
from slam_bof.store.integrity import check_map
from slam_bof.store.map_store import MapStore
from slam_bof.store.pruning import drop_keyframes
from slam_bof.store.row_checks import find_fault
from slam_bof.store.row_codec import INSERT_FRAME, decode_frame, encode_frame
from slam_bof.store.schema import KEY_COLUMNS, SMOOTHED_COLUMNS
from slam_bof.store.schema_repair import has_header, repair_schema
from slam_bof.store.sqlite import as_map_errors, columns, possible_rowids, update_checksums
from slam_bof.types import LOST

__all__ = ["RecoveryResult", "recover_map"]

MAX_GAPS = 10
"""Most frames that are filled in, for each that is whole."""
UNREADABLE = (sqlite3.DatabaseError, UnicodeDecodeError)
"""What SQLite raises for damage; texts of its errors may be damaged, too."""
UNKNOWN_SESSION = ("", "", "", 0, "", None)
"""Data set, sequence, configuration, seed, version and frame limit of an unreadable session."""


class RecoveryResult(NamedTuple):
    """How many keyframes were recovered, how many are lost, and whether the camera is.

    Without the camera the poses and labels can be used, but not the depth images.
    """

    n_keyframes: int
    n_lost: int
    is_camera_lost: bool


def recover_map(path: Path | str, out: Path | str) -> RecoveryResult:
    """Copy the intact rows of a damaged map into a new one.

    A keyframe whose row, depth image or frame is damaged is left out, with everything that refers
    to it, and keyframes are renumbered. Other damaged frames become frames without a pose of
    their own (``LOST``), between their neighbours. Of a damaged session everything readable is
    kept. All sessions count as finished, an interrupted one too.

    Raises
    ------
    MapError
        If nothing can be read, no keyframe is intact, rows contradict each other, or the new file
        exists.
    """
    path, out = Path(path), Path(out)
    with ExitStack() as stack:
        source = stack.enter_context(_open(path, stack))
        # Damaged text may not be valid UTF-8; the checksum of its row reveals it.
        source.connection.text_factory = lambda text: text.decode(errors="surrogateescape")
        target = stack.enter_context(MapStore.create(out))
        try:
            with as_map_errors(path):
                known = _last_id(source.connection)
            with target.transaction() as db:
                db.execute("PRAGMA defer_foreign_keys = ON")
                for table in KEY_COLUMNS:
                    _copy_rows(source.connection, db, table)
                _add_sessions(source.connection, db)
                ids = {row["id"] for row in db.execute("SELECT id FROM keyframes")}
                intact = {row["id"] for row in db.execute(INTACT_KEYFRAMES)}
                _clear_dangling_references(db)
                drop_keyframes(db, ids - intact)
                _fill_missing_frames(db, path)
            if not intact:
                raise MapError(f"{path}: found no intact keyframe, expected at least one")
            found = check_map(out)
            is_camera_lost = any(damage.row == "camera" for damage in found)
            if len(found) > is_camera_lost:
                raise MapError(f"{path}: found what no map can have, {found[-1]}, expected a map")
        except BaseException:
            out.unlink()
            raise
    return RecoveryResult(len(intact), max(known, len(ids)) - len(intact), is_camera_lost)


INTACT_KEYFRAMES = """
SELECT k.id FROM keyframes AS k
    JOIN views ON keyframe_id = k.id
    JOIN frames AS f ON f.session = k.session AND f.frame_index = k.frame_index
"""


def _open(path: Path, stack: ExitStack) -> MapStore:
    """Open a map; if that fails, open a copy of it with a repaired header and schema."""
    try:
        return MapStore.open(path)
    except MapError:
        if not path.is_file() or not has_header(path):
            raise  # what is no database may be too large to copy
        copy = Path(stack.enter_context(TemporaryDirectory())) / "map.db"
        for end in ("", "-wal"):
            file = Path(f"{path.resolve()}{end}")
            if file.exists():
                shutil.copyfile(file, f"{copy}{end}")
        try:
            repair_schema(copy)
            return MapStore.open(copy)
        except (*UNREADABLE, MapError):
            pass  # the first error says what is wrong with the file itself
        raise


def _last_id(db: sqlite3.Connection) -> int:
    """Return how many keyframes the map seems to have had."""
    try:
        ((last,),) = db.execute("SELECT max(id) FROM keyframes").fetchall()
    except UNREADABLE:
        return 0
    return 0 if last is None else int(last) + 1


def _copy_rows(source: sqlite3.Connection, target: sqlite3.Connection, table: str) -> None:
    """Copy the intact rows of a table."""
    names = [*columns(source, table), "crc"]
    marks = ", ".join("?" * len(names))
    # OR IGNORE: a page that the damaged file refers to twice yields its rows twice.
    insert = f"INSERT OR IGNORE INTO {table} ({', '.join(names)}) VALUES ({marks})"
    select = f"SELECT {', '.join(names)} FROM {table}"
    for rowid in _candidate_rowids(source, table):
        try:
            row = source.execute(f"{select} WHERE rowid = ?", (rowid,)).fetchone()
        except UNREADABLE:
            continue
        if row is not None and not find_fault(table, row):
            target.execute(insert, tuple(row))


def _candidate_rowids(db: sqlite3.Connection, table: str) -> Sequence[int]:
    """Return the row numbers to try."""
    try:
        return [rowid for (rowid,) in db.execute(f"SELECT rowid FROM {table}").fetchall()]
    except UNREADABLE:
        return possible_rowids(db, table)


def _add_sessions(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Add damaged sessions with what can be read of them, and mark all sessions finished."""
    found = {row["id"] for row in target.execute("SELECT id FROM sessions")}
    ((last,),) = target.execute(
        "SELECT max(id) FROM (SELECT id FROM sessions UNION SELECT session FROM keyframes)"
    ).fetchall()
    for id_ in sorted(set(range(-1 if last is None else last + 1)) - found):
        target.execute(
            "INSERT INTO sessions (id, dataset, sequence, config, seed, version, max_frames)"
            " VALUES (?, ?, ?, ?, ?, ?, ?)",
            (id_, *_read_session(source, id_)),
        )
    target.execute("UPDATE sessions SET is_finished = 1, state = NULL")


def _read_session(db: sqlite3.Connection, id_: int) -> tuple[object, ...]:
    """Return the values of a damaged session if all are plausible, else ``UNKNOWN_SESSION``."""
    try:
        row = db.execute(
            "SELECT dataset, sequence, config, seed, version, max_frames FROM sessions"
            " WHERE id = ?",
            (id_,),
        ).fetchone()
    except UNREADABLE:
        return UNKNOWN_SESSION
    if row is None or any(
        not isinstance(value, (str, int)[is_number])
        for value, is_number in zip(tuple(row)[:5], (0, 0, 0, 1, 0), strict=True)
    ):
        return UNKNOWN_SESSION
    seed = max(row["seed"], 0)
    texts = [text.encode(errors="surrogateescape").decode(errors="replace") for text in row[:3]]
    try:
        configs.parse_saved(texts[2], "")
    except ConfigError:
        texts[2] = ""
    n = row["max_frames"]
    return (*texts, seed, "", n if isinstance(n, int) and n > 0 else None)


def _clear_dangling_references(db: sqlite3.Connection) -> None:
    """Clear references to rooms, sessions and scene classes that are lost."""
    db.execute("UPDATE keyframes SET region = NULL WHERE region NOT IN (SELECT id FROM regions)")
    db.execute(
        "UPDATE candidates SET left_out_by = NULL"
        " WHERE left_out_by NOT IN (SELECT id FROM sessions)"
    )
    rows = db.execute("SELECT value FROM parameters WHERE key = 'classes'").fetchall()
    n_bytes = 8 * len(json.loads(rows[0]["value"])) if rows else 0
    raw, smoothed = ("scene", "scene_probability", "probabilities"), list(SMOOTHED_COLUMNS)[:3]
    for names in (raw, smoothed):
        db.execute(
            f"UPDATE keyframes SET {', '.join(f'{name} = NULL' for name in names)}"
            f" WHERE length({names[2]}) != ?",
            (n_bytes,),
        )


def _fill_missing_frames(db: sqlite3.Connection, path: Path) -> None:
    """Insert ``LOST`` frames for missing ones, so that frame indices stay without gaps."""
    for (session,) in db.execute("SELECT id FROM sessions").fetchall():
        rows = db.execute(
            "SELECT * FROM frames WHERE session = ? ORDER BY frame_index", (session,)
        ).fetchall()
        if not rows:
            continue
        indices = np.array([row["frame_index"] for row in rows])
        if indices[-1] > MAX_GAPS * (len(rows) + 1000):
            raise MapError(
                f"{path}: found {len(rows)} frames up to number {indices[-1]}, "
                "expected most of them"
            )
        stamps_s = np.array([row["stamp_s"] for row in rows])
        step_s = float(np.median(np.diff(stamps_s) / np.diff(indices))) if len(rows) > 1 else 1.0
        for index in sorted(set(range(indices[-1])) - set(indices.tolist())):
            after = int(np.searchsorted(indices, index))
            neighbour = decode_frame(rows[max(after - 1, 0)])
            stamp_s = float(np.interp(index, indices, stamps_s))
            stamp_s += step_s * min(index - indices[0], 0)
            frame = replace(neighbour, stamp_s=stamp_s, segment=LOST)
            db.execute(INSERT_FRAME, encode_frame(session, index, frame))
    update_checksums(db, "frames")
