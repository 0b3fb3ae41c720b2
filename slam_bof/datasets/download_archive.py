"""Unpack archives of unknown origin safely.

Every byte is checked by checksum. Only files and folders within the target folder are written, no
links, and all together, archives within the archive included, not more than the disk can hold or a
hundred times the size of the archive.
"""

from __future__ import annotations

import gzip
import shutil
import stat
import struct
import tarfile
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import IO, Any, cast

from slam_bof.errors import DatasetError

__all__ = ["BadArchive", "Limits", "unpack"]

Progress = Callable[[int, int], None]
"""Called with the number of bytes of the archive that are unpacked, and of all."""

CHUNK_BYTES = 1 << 20


DAMAGED = (
    zipfile.BadZipFile,
    tarfile.TarError,
    zlib.error,
    struct.error,
    EOFError,
    LookupError,
    ValueError,  # names in no known coding
    OverflowError,
)
"""What the libraries raise for damaged archives."""


class BadArchive(DatasetError):
    """An archive is damaged, incomplete or unsafe to unpack."""


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of the content of an archive.

    ``ratio`` is the largest ratio of the unpacked to the packed size, for content larger than
    ``free_of_ratio_bytes``. It is about 2 for depth images, which are compressed themselves.
    ``margin_bytes`` of the disk stay free.
    """

    ratio: float = 100.0
    free_of_ratio_bytes: int = 10_000_000
    n_entries: int = 2_000_000
    margin_bytes: int = 200_000_000


def unpack(
    archive: Path,
    folder: Path,
    *,
    limits: Limits | None = None,
    progress: Progress | None = None,
) -> None:
    """Unpack a .zip, .tgz or .tar.gz file into a folder, and then the .zip files in it.

    Inner zip files (7-Scenes has one for each sequence) are unpacked into their own folders and
    removed. Zip files within those are not unpacked.

    Parameters
    ----------
    archive
        The file.
    folder
        It is created if it does not exist. After an error it contains a part of the files.
    limits, progress
        Limits of the content, and a function that is called with the progress.

    Raises
    ------
    BadArchive
        If the archive is damaged or incomplete, has a link or a name that leads out of the folder,
        or exceeds the limits.
    DatasetError
        If the disk is full or cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    budget = _Budget(archive, folder, limits or Limits())
    inner = [folder / name for name in _unpack_one(archive, folder, budget, progress)]
    for nested in sorted(path for path in inner if path.suffix.lower() == ".zip"):
        _unpack_one(nested, nested.parent, budget, progress)
        nested.unlink()


def _unpack_one(
    archive: Path, folder: Path, budget: _Budget, progress: Progress | None
) -> list[PurePosixPath]:
    """Unpack an archive; return the names of its files."""
    unpack_kind = _unpack_zip if archive.suffix.lower() == ".zip" else _unpack_tar
    with _naming(archive):
        return unpack_kind(archive, folder, budget, progress or (lambda done, total: None))


class _Budget:
    """Counts entries and bytes of an archive, at all levels, and refuses too many."""

    def __init__(self, archive: Path, folder: Path, limits: Limits) -> None:
        self._archive = archive
        self._n_entries = 0
        self._n_bytes = 0
        self._limits = limits
        size = archive.stat().st_size
        self.n_most = max(int(limits.ratio * size), limits.free_of_ratio_bytes)
        self._free = shutil.disk_usage(folder).free - limits.margin_bytes

    def take(self, n_bytes: int) -> None:
        """Count an entry of ``n_bytes`` bytes before it is written."""
        if n_bytes < 0:
            self._refuse(f"an entry of {n_bytes} bytes", "some or none")
        self._n_entries += 1
        self._n_bytes += n_bytes
        if self._n_entries > self._limits.n_entries:
            self._refuse(f"more than {self._limits.n_entries} entries", "a data set")
        if self._n_bytes > self.n_most:
            self._refuse(f"more than {self.n_most} bytes inside", "a data set, not a bomb")
        if self._n_bytes > self._free:
            raise DatasetError(
                f"{self._archive}: found {self._n_bytes} bytes inside and more, "
                f"expected at most {self._free}, which the disk can take"
            )

    def _refuse(self, found: str, expected: str) -> None:
        raise BadArchive(f"{self._archive}: found {found}, expected {expected}")


def _unpack_zip(
    archive: Path, folder: Path, budget: _Budget, progress: Progress
) -> list[PurePosixPath]:
    names = []
    with zipfile.ZipFile(archive) as packed:
        entries = packed.infolist()
        for entry in entries:  # all are checked before the first is written
            _inside(archive, entry.filename)
            if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise NotImplementedError(f"found compression {entry.compress_type}")
            mode = entry.external_attr >> 16
            if stat.S_IFMT(mode) not in (0, stat.S_IFREG, stat.S_IFDIR):
                raise _elsewhere(archive, entry.filename, "a link or device")
            budget.take(entry.file_size)
        total = sum(entry.compress_size for entry in entries)
        done = 0
        for entry in entries:
            name = _inside(archive, entry.filename)
            if entry.filename.endswith(("/", "\\")):
                (folder / name).mkdir(parents=True, exist_ok=True)
            else:
                with packed.open(entry) as source:
                    _write(source, folder / name)
                names.append(name)
            done += entry.compress_size
            progress(done, total)
    return names


def _unpack_tar(
    archive: Path, folder: Path, budget: _Budget, progress: Progress
) -> list[PurePosixPath]:
    names = []
    total = archive.stat().st_size
    with (
        archive.open("rb") as raw,
        gzip.GzipFile(fileobj=raw) as unzipped,
        tarfile.open(fileobj=cast(Any, _Bounded(unzipped, 2 * budget.n_most)), mode="r:") as packed,
    ):
        for entry in packed:
            name = _inside(archive, entry.name)
            budget.take(entry.size)
            if entry.isdir():
                (folder / name).mkdir(parents=True, exist_ok=True)
                continue
            source = packed.extractfile(entry) if entry.isreg() else None
            if source is None:
                raise _elsewhere(archive, entry.name, "a link or device")
            with source:
                _write(source, folder / name)
            names.append(name)
            progress(raw.tell(), total)
        # The checksum follows the end of the archive, at the end of the file.
        while packed.fileobj is not None and packed.fileobj.read(CHUNK_BYTES):
            pass
    return names


class _Bounded:
    """A stream for ``tarfile``, which believes the sizes of headers, gigabytes too."""

    def __init__(self, stream: gzip.GzipFile, n_most: int) -> None:
        self._stream = stream
        self._n_most = n_most

    def read(self, n_bytes: int) -> bytes:
        """Return the next bytes; refuse a large or negative number, as of a header."""
        if not 0 <= n_bytes <= CHUNK_BYTES or self.tell() > self._n_most:
            raise tarfile.ReadError(f"{n_bytes} bytes at {self.tell()} are too many for an entry")
        return self._stream.read(n_bytes)

    def seek(self, position: int) -> int:
        """Go on to a position, over what is not read."""
        if not self.tell() <= position <= self._n_most:
            raise tarfile.ReadError(f"an entry at {position} after {self.tell()}")
        return self._stream.seek(position)

    def tell(self) -> int:
        """Return the position in the unpacked stream."""
        return self._stream.tell()


def _write(source: IO[bytes], path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as file:
        shutil.copyfileobj(source, file, CHUNK_BYTES)


def _inside(archive: Path, name: str) -> PurePosixPath:
    """Return the path of a name from any system; refuse one that leads out of the folder."""
    path = PurePosixPath(name.replace("\\", "/"))  # some packers on Windows
    has_drive = bool(path.parts) and ":" in path.parts[0]
    if not path.parts or path.is_absolute() or ".." in path.parts or has_drive or "\0" in name:
        raise _elsewhere(archive, name, "a path that leads elsewhere")
    return path


def _elsewhere(archive: Path, name: str, what: str) -> BadArchive:
    return BadArchive(f"{archive}: found {what}: {name[:80]!r}, expected files inside")


@contextmanager
def _naming(archive: Path) -> Iterator[None]:
    """Turn errors of the libraries about damaged archives into one line that names the file."""
    try:
        yield
    except (NotImplementedError, RuntimeError) as error:  # unknown compression, or a password
        raise BadArchive(f"{archive}: cannot be unpacked: {_in_one_line(error)}") from error
    except DAMAGED as error:
        raise BadArchive(
            f"{archive}: found damage ({_in_one_line(error)}), expected a whole archive"
        ) from error
    except OSError as error:
        if error.errno is None:  # gzip: not a gzip file
            raise BadArchive(f"{archive}: found damage ({error}), expected an archive") from error
        place = error.filename or archive
        raise DatasetError(f"{place}: cannot be unpacked: {error.strerror}") from error


def _in_one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200] or type(error).__name__
