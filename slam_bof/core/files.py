"""Files from anywhere, read whole: a sparse file or a device may be larger than the memory."""

from __future__ import annotations

import errno
import io
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["naming", "open_bytes", "read_bytes", "read_text", "refuse_named_pipe"]

MAX_BYTES = 1 << 29
MAX_TEXT_BYTES = 1 << 27
"""A million poses in TUM format take some 100 MB."""


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Name a file in errors that do not, such as that of a disk that is full."""
    try:
        yield
    except OSError as error:
        if error.filename is None and error.errno is not None:
            error.filename = str(path)
        raise


def open_bytes(path: Path) -> io.BufferedReader:
    """Open a file to read its bytes.

    A pipe of the shell, such as ``<(slam-bof config)``, is opened too.

    Raises
    ------
    OSError
        If the file cannot be opened, or is a named pipe: opening it may wait forever for a writer.
    """
    refuse_named_pipe(path)
    return path.open("rb")


def refuse_named_pipe(path: Path) -> None:
    """Raise ``OSError`` for a named pipe: opening it may wait forever for the other side.

    A pipe of the shell, such as ``>(gzip > page.html.gz)``, may be opened, and a file that is
    missing may be written.
    """
    if path.is_fifo():
        place = os.path.realpath(path)  # of a shell's pipe that is no file, or is in /dev
        if os.path.exists(place) and not place.startswith("/dev/"):
            raise OSError(errno.EINVAL, "a named pipe", str(path))


def read_bytes(path: Path, max_bytes: int = MAX_BYTES) -> bytes:
    """Return the content of a file of moderate size.

    Raises
    ------
    OSError
        If the file cannot be read, is a named pipe, or is larger than ``max_bytes``.
    """
    with open_bytes(path) as file:
        # A device or a pipe says a size of 0.
        n_bytes = os.fstat(file.fileno()).st_size or max_bytes
        data = file.read(min(n_bytes, max_bytes) + 1)
    if len(data) > max_bytes:
        raise OSError(errno.EFBIG, f"more than {max_bytes} bytes", str(path))
    return data


def read_text(path: Path, errors: str = "strict", max_bytes: int = MAX_TEXT_BYTES) -> str:
    """Return the content of a text file in UTF-8, with or without a byte order mark.

    Raises
    ------
    OSError
        See ``read_bytes``.
    UnicodeDecodeError
        If it is no UTF-8, and ``errors`` is "strict".
    """
    return read_bytes(path, max_bytes).decode("utf-8-sig", errors)
