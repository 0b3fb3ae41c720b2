"""A ``map.db`` as a file: made, opened, locked against a second writer, written in transactions."""

from __future__ import annotations

import contextlib
import fcntl
import os
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from slam_bof.errors import MapError
from slam_bof.store.migrations import UPGRADES, upgrade
from slam_bof.store.schema import APPLICATION_ID, SCHEMA, SCHEMA_VERSION
from slam_bof.store.schema_repair import check_layout
from slam_bof.store.sqlite import FOUND, connect, naming_errors

__all__ = ["MapFile"]


class MapFile:
    """A map.db, open for reading or for writing; one program at a time may write.

    Every method raises ``MapError``, one line that names the file, where it cannot be read or
    written.
    """

    def __init__(
        self, path: Path, connection: sqlite3.Connection, *, lock: _WriterLock | None = None
    ) -> None:
        self.path = path
        self._db = connection
        self._lock = lock

    @classmethod
    def create(cls, path: Path | str) -> Self:
        """Make an empty map; ``MapError`` if there is a file already.

        It appears at once as a whole, however the program ends.
        """
        path = Path(path)
        with contextlib.ExitStack() as on_error:
            lock = on_error.enter_context(_WriterLock(path))
            if path.exists():
                raise MapError(f"{path}: found a file, expected none where a new map is to be made")
            new = path.with_name(f".{path.name}.new")
            with naming_errors(path):
                new.unlink(missing_ok=True)
                on_error.callback(new.unlink, missing_ok=True)
                db = connect(new, "rwc")
                with contextlib.closing(db):
                    db.executescript(SCHEMA)
                new.rename(path)
                db = connect(path, "rw")
                on_error.callback(db.close)
                db.execute("PRAGMA journal_mode = WAL")
            lock.hold(path)
            on_error.pop_all()
        return cls(path, db, lock=lock)

    @classmethod
    def open(cls, path: Path | str, *, read_only: bool = True) -> Self:
        """Open a map; one that a run is still writing can be read too.

        One of an older version is upgraded: in its file if it may be written, else in memory.
        ``MapError`` if there is none, it is of a version not known, or somebody else writes to it
        and it is to be written.
        """
        path = Path(path)
        if not path.is_file():
            found = "a folder" if path.is_dir() else "no file"
            raise MapError(f"{path}: found {found}, expected a map.db")
        with contextlib.ExitStack() as on_error:
            lock = None if read_only else on_error.enter_context(_WriterLock(path))
            with naming_errors(path, otherwise=sqlite3.SQLITE_CORRUPT):
                db = connect(path, "ro" if read_only else "rw")
                on_error.callback(lambda: db.close())
                version = _version(db, path)
                if version != SCHEMA_VERSION:
                    db = upgrade(db, version, in_place=not read_only)
                wrong = check_layout(db)
                if wrong:
                    raise MapError(
                        f"{path}: found damage in what says how it is read ({wrong}); "
                        "slam-bof map recover saves what is whole into a new map"
                    )
                if lock is not None:
                    db.execute("PRAGMA journal_mode = WAL")
                    lock.hold(path)
            on_error.pop_all()
        return cls(path, db, lock=lock)

    def close(self) -> None:
        """Close the file; the last writer leaves no files beside it."""
        if self._lock is not None:
            # Out of WAL mode the map can be read from read-only media. While somebody else
            # has it open that cannot be, and the file stays in WAL mode, which is as good.
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file; what was committed stays."""
        self.close()

    @property
    def connection(self) -> sqlite3.Connection:
        """SQLite's own, for those who look at the file itself."""
        return self._db

    def select(self, statement: str, *values: object) -> list[Any]:
        """Run a SELECT; rows can be indexed by column name."""
        with naming_errors(self.path):
            return self._db.execute(statement, values).fetchall()

    @contextlib.contextmanager
    def transaction(self) -> Iterator[sqlite3.Connection]:
        """Commit all that the block writes or, on an error, nothing.

        ``MapError`` if the file was removed meanwhile: SQLite would go on with what no one sees.
        """
        if self._lock is not None and not self._lock.is_of(self.path):
            raise MapError(f"{self.path}: found it removed or replaced while it was being written")
        with naming_errors(self.path):
            self._db.execute("BEGIN IMMEDIATE")
            try:
                yield self._db
                self._db.execute("COMMIT")
            except BaseException:
                if self._db.in_transaction:
                    self._db.execute("ROLLBACK")
                raise

    def copy_to(self, path: Path) -> None:
        """Copy the map into a new file, as it is in this moment."""
        with naming_errors(path):
            copy = sqlite3.connect(path)
            with contextlib.closing(copy):
                self._db.backup(copy)

    def vacuum(self) -> None:
        """Give the room of deleted rows back."""
        with naming_errors(self.path):
            self._db.execute("VACUUM")


class _WriterLock:
    """Held by the one program that writes to a map, as long as it lives: a file beside it."""

    def __init__(self, path: Path) -> None:
        # By whichever link a program comes, there is one lock.
        self._file = Path(f"{path.resolve()}-lock")
        while True:
            try:
                self._descriptor = os.open(self._file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            except OSError as error:
                raise MapError(f"{path}: cannot be opened for writing: {error.strerror}") from error
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(self._descriptor)
                raise MapError(f"{path}: {FOUND[sqlite3.SQLITE_BUSY]}") from None
            if self._is_current():
                return
            os.close(self._descriptor)  # of a file that the last writer has just removed

    def hold(self, path: Path) -> None:
        """Note which file it is that is written."""
        self._written = path.stat()

    def is_of(self, path: Path) -> bool:
        """Tell whether a path still is of the file that is written."""
        try:
            return os.path.samestat(self._written, path.stat())
        except FileNotFoundError:
            return False

    def release(self) -> None:
        """Let others write."""
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
    """Return the version of a map's layout, this or one that can be upgraded."""
    ((application_id,),) = db.execute("PRAGMA application_id").fetchall()
    ((version,),) = db.execute("PRAGMA user_version").fetchall()
    if application_id != APPLICATION_ID:
        raise MapError(f"{path}: found no map in this database, expected a map.db of slam_bof")
    if version != SCHEMA_VERSION and version not in UPGRADES:
        expected = ", ".join(map(str, (*UPGRADES, SCHEMA_VERSION)))
        raise MapError(f"{path}: found map version {version}, expected one of {expected}")
    return int(version)
