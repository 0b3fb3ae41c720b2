"""A ``map.db`` file: created, opened, locked against a second writer, written in transactions."""

from __future__ import annotations

import contextlib
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Self

from slam_bof.core import lock_file
from slam_bof.errors import MapError
from slam_bof.store.migrations import MIGRATABLE_VERSIONS, migrate
from slam_bof.store.schema import APPLICATION_ID, SCHEMA, SCHEMA_VERSION
from slam_bof.store.schema_repair import check_schema
from slam_bof.store.sqlite import ERROR_MESSAGES, as_map_errors, connect

__all__ = ["MapDatabase"]


class MapDatabase:
    """A map.db, open for reading or for writing; one program at a time may write.

    Every method raises ``MapError``, with one line that names the file, if the file cannot be
    read or written.
    """

    def __init__(
        self, path: Path, connection: sqlite3.Connection, *, lock: _WriterLock | None = None
    ) -> None:
        self.path = path
        self._db = connection
        self._lock = lock

    @classmethod
    def create(cls, path: Path | str) -> Self:
        """Create an empty map.

        The file is written under another name and renamed when complete, so that a killed program
        leaves no half-made map.

        Raises
        ------
        MapError
            If the file exists.
        """
        path = Path(path)
        with contextlib.ExitStack() as on_error:
            lock = on_error.enter_context(_WriterLock(path))
            if os.path.lexists(path):  # also a link to nothing, which the map would replace
                found = "a file" if path.exists() else "a link to nothing"
                raise MapError(f"{path}: found {found}, expected none: a new map needs a new name")
            new = path.with_name(f".{path.name}.new")
            with as_map_errors(path):
                new.unlink(missing_ok=True)
                on_error.callback(new.unlink, missing_ok=True)
                db = connect(new, "rwc")
                with contextlib.closing(db):
                    db.executescript(SCHEMA)
                new.rename(path)
                db = connect(path, "rw")
                on_error.callback(db.close)
                db.execute("PRAGMA journal_mode = WAL")
            lock.remember(path)
            on_error.pop_all()
        return cls(path, db, lock=lock)

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = True) -> Self:
        """Open a map, or that in the folder of a run; one that is being written can be read.

        A map of an older version is migrated, in its file if it is opened for writing, otherwise
        in memory.

        Raises
        ------
        MapError
            If there is no map, its version is unknown or its schema damaged, or it is opened for
            writing while another program writes to it.
        """
        path = Path(path)
        try:
            if path.is_dir() and (path / "map.db").exists():
                path = path / "map.db"
            found = "" if path.is_file() else "a folder" if path.is_dir() else "no file"
        except OSError as error:  # such as a name that is too long
            found = str(error.strerror)
        if found:
            raise MapError(f"{path}: found {found}, expected a map.db")
        with contextlib.ExitStack() as on_error:
            lock = None if read_only else on_error.enter_context(_WriterLock(path))
            with as_map_errors(path, otherwise=sqlite3.SQLITE_CORRUPT):
                db = connect(path, "ro" if read_only else "rw")
                on_error.callback(lambda: db.close())
                version = _version(db, path)
                if version != SCHEMA_VERSION:
                    db = migrate(db, version, path, in_place=not read_only)
                wrong = check_schema(db)
                if wrong:
                    raise MapError(
                        f"{path}: found {wrong}; "
                        "slam-bof map recover copies the intact rows into a new map"
                    )
                if lock is not None:
                    db.execute("PRAGMA journal_mode = WAL")
                    lock.remember(path)
            on_error.pop_all()
        return cls(path, db, lock=lock)

    def close(self) -> None:
        """Close the file; after the last writer no other files are left beside it."""
        if self._lock is not None and self._lock.is_forked():
            return  # the file is another process's, which goes on writing
        if self._lock is not None:
            # Without WAL mode the map can be read from read-only media. SQLite cannot leave WAL
            # mode while another program has the file open; the map is complete in either mode.
            with contextlib.suppress(sqlite3.OperationalError):
                self._db.execute("PRAGMA busy_timeout = 0")
                self._db.execute("PRAGMA journal_mode = DELETE")
        self._db.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def __enter__(self) -> Self:
        """Return the map itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file; committed data is kept."""
        self.close()

    @property
    def connection(self) -> sqlite3.Connection:
        """The underlying SQLite connection."""
        return self._db

    @contextlib.contextmanager
    def snapshot(self) -> Iterator[None]:
        """Read one state of the map in all selects of the block, also while it is written."""
        if self._db.in_transaction:
            yield
            return
        with as_map_errors(self.path):
            self._db.execute("BEGIN")
        try:
            yield
        finally:
            if self._db.in_transaction:
                self._db.execute("ROLLBACK")

    def select(self, statement: str, *values: object) -> list[Any]:
        """Return the rows of a SELECT; they can be indexed by column name."""
        with as_map_errors(self.path):
            return self._db.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Commit everything that the block writes or, on an error, nothing.

        Raises
        ------
        MapError
            If the file was removed or replaced: SQLite would write to a file without a name.
        """
        if self._lock is not None and not self._lock.is_still(self.path):
            raise MapError(f"{self.path}: found it removed or replaced while it was being written")
        with as_map_errors(self.path):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def copy_to(self, path: Path) -> None:
        """Copy the map, as it is now, into a new file."""
        with as_map_errors(path):
            copy = sqlite3.connect(path)
            with contextlib.closing(copy):
                self._db.backup(copy)

    def vacuum(self) -> None:
        """Rebuild the file without the space of deleted rows."""
        with as_map_errors(self.path):
            self._db.execute("VACUUM")


class _WriterLock:
    """A lock file beside a map, held by the one program that writes to it."""

    def __init__(self, path: Path) -> None:
        self._process_id = os.getpid()
        # Resolved, so that programs that use different symbolic links share one lock.
        self._file = Path(f"{os.path.realpath(path)}-lock")
        while True:
            try:
                flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0)
                self._descriptor = os.open(self._file, flags, 0o644)
            except OSError as error:
                raise MapError(f"{path}: cannot be opened for writing: {error.strerror}") from error
            try:
                lock_file(self._descriptor)
            except (BlockingIOError, PermissionError):
                os.close(self._descriptor)
                raise MapError(f"{path}: {ERROR_MESSAGES[sqlite3.SQLITE_BUSY]}") from None
            if self._is_current():
                return
            os.close(self._descriptor)  # the previous writer has just removed this lock file

    def remember(self, path: Path) -> None:
        """Remember which file is being written."""
        self._written = path.stat()

    def is_still(self, path: Path) -> bool:
        """Return whether a path still names the file that is being written."""
        try:
            return os.path.samestat(self._written, path.stat())
        except FileNotFoundError:
            return False

    def is_forked(self) -> bool:
        """Return whether this is a fork of the process that holds the lock."""
        return os.getpid() != self._process_id

    def release(self) -> None:
        """Remove the lock file, so that others can write."""
        self._file.unlink(missing_ok=True)
        os.close(self._descriptor)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()

    def _is_current(self) -> bool:
        try:
            return os.path.samestat(os.fstat(self._descriptor), self._file.stat())
        except FileNotFoundError:
            return False


def _version(db: sqlite3.Connection, path: Path) -> int:
    """Return a map's schema version, the current one or one that can be migrated."""
    ((application_id,),) = db.execute("PRAGMA application_id").fetchall()
    ((version,),) = db.execute("PRAGMA user_version").fetchall()
    if application_id != APPLICATION_ID:
        raise MapError(f"{path}: found another program's database, expected a map.db of slam_bof")
    if version != SCHEMA_VERSION and version not in MIGRATABLE_VERSIONS:
        expected = ", ".join(map(str, (*MIGRATABLE_VERSIONS, SCHEMA_VERSION)))
        raise MapError(f"{path}: found map version {version}, expected one of {expected}")
    return int(version)
