"""The map on disk: ``map.db`` (see ``schema`` for its tables), written keyframe by keyframe.

Each keyframe is committed with its candidates and loops as it comes (write-ahead logging), so
a killed run loses at most the keyframe in hand. When the writer closes, all is in one file.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from slam_bof.errors import MapError
from slam_bof.regions import Region
from slam_bof.rows import (
    INSERT_CANDIDATE,
    INSERT_KEYFRAME,
    INSERT_LOOP,
    INSERT_REGION,
    candidate_of,
    candidate_row,
    cloud_of,
    keyframe_of,
    keyframe_row,
    loop_of,
    loop_row,
    pose_of,
    pose_row,
    region_of,
    region_row,
    scene_row,
)
from slam_bof.schema import (
    APPLICATION_ID,
    POSE,
    SCHEMA,
    SCHEMA_VERSION,
    SMOOTHED,
    UPGRADES,
    connect,
    naming_errors,
    upgrade,
)
from slam_bof.types import Array, Candidate, Keyframe, Loop, Scene

__all__ = ["MapStore"]


class MapStore:
    """A map.db, open for reading or for writing.

    Every method raises ``MapError``, one line that names the file, where it cannot be read or
    written.

    Examples
    --------
    >>> with MapStore.create("map.db") as store:  # doctest: +SKIP
    ...     store.add(step.keyframe, step.candidates, step.loops)
    >>> with MapStore.open("map.db") as store:  # doctest: +SKIP
    ...     keyframes = store.keyframes()
    """

    def __init__(self, path: Path, connection: sqlite3.Connection, *, writes: bool) -> None:
        self.path = path
        self._db = connection
        self._writes = writes
        self._classes: tuple[str, ...] | None = None

    @classmethod
    def create(cls, path: Path | str) -> Self:
        """Make an empty map; ``MapError`` if there is a file already."""
        path = Path(path)
        if path.exists():
            raise MapError(f"{path}: found a file, expected none where a new map is to be made")
        with naming_errors(path):
            db = connect(path, "rwc")
            db.executescript(SCHEMA)
            db.execute("PRAGMA journal_mode = WAL")
        return cls(path, db, writes=True)

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = True) -> Self:
        """Open a map; one that a run is still writing can be read too.

        One of an older version is upgraded: in its file if it may be written, else in memory.
        ``MapError`` if there is none, or it is of a version not known.
        """
        path = Path(path)
        if not path.is_file():
            found = "a folder" if path.is_dir() else "no file"
            raise MapError(f"{path}: found {found}, expected a map.db")
        with naming_errors(path):
            db = connect(path, "ro" if read_only else "rw")
            try:
                version = _version(db, path)
                if version != SCHEMA_VERSION:
                    db = upgrade(db, version, in_place=not read_only)
                if not read_only:
                    db.execute("PRAGMA journal_mode = WAL")
            except BaseException:
                db.close()
                raise
        return cls(path, db, writes=not read_only)

    def close(self) -> None:
        """Close the file; the last writer leaves no files beside it."""
        if self._writes:
            # Out of WAL mode the map can be read from read-only media. While somebody else
            # has it open that cannot be, and the file stays in WAL mode, which is as good.
            with contextlib.suppress(sqlite3.OperationalError):
                self._db.execute("PRAGMA busy_timeout = 0")
                self._db.execute("PRAGMA journal_mode = DELETE")
        self._writes = False
        self._db.close()

    def __enter__(self) -> Self:
        """Return the store itself."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file; what was committed stays."""
        self.close()

    def add(
        self,
        keyframe: Keyframe,
        candidates: Iterable[Candidate] = (),
        loops: Iterable[Loop] = (),
        *,
        cloud: Array | None = None,
    ) -> None:
        """Save a keyframe and what was decided about it: all of it or, on an error, nothing.

        Parameters
        ----------
        keyframe, candidates, loops
            As a ``Step`` has them.
        cloud
            (N, 3) points_camera to keep with the keyframe, as float32.

        Raises
        ------
        ValueError
            If the keyframe's id is taken, a candidate or loop names a keyframe that is not
            there, or the scene classes are not those of the keyframes before.
        """
        with self._transaction():
            if keyframe.scene is not None:
                self._keep_classes(keyframe.scene.classes)
            self._db.execute(INSERT_KEYFRAME, keyframe_row(keyframe, cloud))
            self._db.executemany(INSERT_CANDIDATE, map(candidate_row, candidates))
            loops = list(loops)
            self._db.executemany(INSERT_LOOP, map(loop_row, loops))
            # A loop that was held back until others agreed was a candidate of an earlier keyframe.
            self._db.executemany(
                "UPDATE candidates SET decision = 'accepted', reason = '' "
                "WHERE query_id = ? AND match_id = ? AND source = ? AND decision = 'held'",
                [(loop.query_id, loop.match_id, loop.source) for loop in loops],
            )

    def leave_out(self, loops: Iterable[Loop], reason: str) -> None:
        """Take loops out of the graph again; their candidates become rejected, with the reason."""
        pairs = [(loop.query_id, loop.match_id, loop.source) for loop in loops]
        where = "WHERE query_id = ? AND match_id = ? AND source = ?"
        with self._transaction():
            self._db.executemany(f"DELETE FROM loops {where}", pairs)
            self._db.executemany(
                f"UPDATE candidates SET decision = 'rejected', reason = ? {where} "
                "AND decision = 'accepted'",
                [(reason, *pair) for pair in pairs],
            )

    def set_map_poses(self, T_map_camera: Array) -> None:
        """Save the optimised poses (K, 4, 4) of all keyframes, in the order of their ids."""
        ids = [row["id"] for row in self.select("SELECT id FROM keyframes ORDER BY id")]
        if np.shape(T_map_camera) != (len(ids), 4, 4):
            raise ValueError(f"poses must be ({len(ids)}, 4, 4), got {np.shape(T_map_camera)}")
        rows = [(*pose_row(T), id_) for T, id_ in zip(T_map_camera, ids, strict=True)]
        columns = ", ".join(f"map_{name} = ?" for name in POSE)
        with self._transaction():
            self._db.executemany(f"UPDATE keyframes SET {columns} WHERE id = ?", rows)

    def set_scenes(self, smoothed: Sequence[Scene | None], regions: Sequence[Region]) -> None:
        """Save the smoothed labels (K,) of all keyframes, in the order of their ids, and rooms."""
        ids = [row["id"] for row in self.select("SELECT id FROM keyframes ORDER BY id")]
        if len(smoothed) != len(ids):
            raise ValueError(f"smoothed must have {len(ids)} labels, got {len(smoothed)}")
        region_by_id = {id_: region.id for region in regions for id_ in region.keyframe_ids}
        rows = [
            (*scene_row(scene), region_by_id.get(id_), id_)
            for scene, id_ in zip(smoothed, ids, strict=True)
        ]
        columns = ", ".join(f"{name} = ?" for name in SMOOTHED)
        with self._transaction():
            self._db.executemany(f"UPDATE keyframes SET {columns} WHERE id = ?", rows)
            self._db.execute("DELETE FROM regions")
            self._db.executemany(INSERT_REGION, map(region_row, regions))

    def set_parameters(self, parameters: Mapping[str, object]) -> None:
        """Save what the map was made with; values that are no strings are kept as JSON."""
        with self._transaction():
            for key, value in parameters.items():
                text = value if isinstance(value, str) else json.dumps(value)
                self._db.execute("REPLACE INTO parameters VALUES (?, ?)", (key, text))

    def parameters(self) -> dict[str, str]:
        """Return what the map was made with."""
        rows = self.select("SELECT key, value FROM parameters ORDER BY key")
        return {row["key"]: row["value"] for row in rows}

    def classes(self) -> tuple[str, ...]:
        """Return the scene labels in the order of the probabilities; () without labels."""
        if not self._classes:
            self._classes = tuple(json.loads(self.parameters().get("classes", "[]")))
        return self._classes

    def keyframes(self) -> list[Keyframe]:
        """Return all keyframes, in the order of their ids."""
        rows = self.select("SELECT * FROM keyframes ORDER BY id")
        return [keyframe_of(row, self.classes()) for row in rows]

    def map_poses(self) -> Array:
        """Return T_map_camera of all keyframes, (K, 4, 4), NaN where there is none yet."""
        rows = self.select("SELECT * FROM keyframes ORDER BY id")
        poses = np.full((len(rows), 4, 4), np.nan)
        for i, row in enumerate(rows):
            if row["map_tx"] is not None:
                poses[i] = pose_of(row, "map_")
        return poses

    def regions(self) -> list[Region]:
        """Return the rooms of the map; none until the run is finished."""
        inside: dict[int, list[int]] = {}
        for row in self.select("SELECT id, region FROM keyframes WHERE region IS NOT NULL"):
            inside.setdefault(row["region"], []).append(row["id"])
        rows = self.select("SELECT * FROM regions ORDER BY id")
        return [region_of(row, sorted(inside.get(row["id"], ()))) for row in rows]

    def cloud(self, keyframe_id: int) -> Array | None:
        """Return the points_camera (N, 3) kept with a keyframe, if there are any."""
        rows = self.select("SELECT cloud FROM keyframes WHERE id = ?", keyframe_id)
        return cloud_of(rows[0]) if rows else None

    def loops(self) -> list[Loop]:
        """Return all edges, in the order they came."""
        return [loop_of(row) for row in self.select("SELECT * FROM loops ORDER BY id")]

    def candidates(self) -> list[Candidate]:
        """Return the audit trail, in the order it came."""
        return [candidate_of(row) for row in self.select("SELECT * FROM candidates ORDER BY id")]

    def select(self, statement: str, *values: object) -> list[Any]:
        """Run a SELECT; rows can be indexed by column name."""
        with naming_errors(self.path):
            return self._db.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def _transaction(self) -> Iterator[None]:
        with naming_errors(self.path):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def _keep_classes(self, classes: tuple[str, ...]) -> None:
        known = self.classes()
        if not known:
            text = json.dumps(list(classes))
            self._db.execute("REPLACE INTO parameters VALUES ('classes', ?)", (text,))
        elif known != tuple(classes):
            raise ValueError(f"scene classes must stay {known}, got {tuple(classes)}")


def _version(db: sqlite3.Connection, path: Path) -> int:
    """Return the version of a map's layout, this or one that can be upgraded."""
    ((application_id,),) = db.execute("PRAGMA application_id").fetchall()
    ((version,),) = db.execute("PRAGMA user_version").fetchall()
    if application_id != APPLICATION_ID:
        raise MapError(f"{path}: found no map in this database, expected a map.db of slam_bof")
    if version != SCHEMA_VERSION and version not in UPGRADES:
        expected = " or ".join(map(str, (*UPGRADES, SCHEMA_VERSION)))
        raise MapError(f"{path}: found map version {version}, expected {expected}")
    return int(version)
