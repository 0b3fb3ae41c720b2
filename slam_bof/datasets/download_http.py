"""Download a file over HTTP so that an interrupted download continues where it stopped.

The bytes received so far are in ``NAME.part``, and ``NAME.part.json`` names the version of the
file. The remaining bytes are requested by a range request, which the server ignores if the file
has changed (RFC 9110, 13.1.5 and 14.2). A server without range requests sends the whole file again.
"""

from __future__ import annotations

import http.client
import json
import logging
import re
import shutil
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from slam_bof.core import read_text
from slam_bof.datasets.download_connection import Watchdog, open_url, printable
from slam_bof.errors import DatasetError

__all__ = ["Progress", "fetch"]

logger = logging.getLogger(__name__)

Progress = Callable[[int, int], None]
"""Called with the number of bytes received, and their total (0 if the server does not say)."""

CHUNK_BYTES = 1 << 20
TIMEOUT_S = 60.0
"""A server that sends less than ``MIN_BYTES`` in this time is as good as none."""
MIN_BYTES = 60_000
N_ATTEMPTS = 5
WAIT_S = 2.0
MARGIN_BYTES = 200_000_000
"""Disk space that is left free."""

NUMBER = "[0-9]{1,18}"
CONTENT_RANGE = re.compile(rf"bytes (?:({NUMBER})-{NUMBER}|\*)/({NUMBER})")
PASSING = (429, 500, 502, 503, 504)
"""Status codes of temporary failures."""


class _Cut(Exception):
    """The connection ended early; the bytes received are kept."""


class _Unreachable(_Cut):
    """There was no connection to the server."""


def fetch(
    url: str, path: Path, *, progress: Progress | None = None, wait_s: float = WAIT_S
) -> bool:
    """Download ``url`` to ``path``, unless it is there already; return whether it was downloaded.

    Parameters
    ----------
    url
        An http or https address.
    path
        The file, which appears when it is complete.
    progress
        Called as bytes arrive.
    wait_s
        Seconds to wait after the first failure. The wait doubles after each further one.

    Raises
    ------
    DatasetError
        If the server cannot be reached, has no such file or sends a wrong number of bytes, or the
        disk is full. If possible, the bytes received are kept for the next call.
    """
    if path.is_file():
        return False
    if not url.startswith(("http://", "https://")):
        raise DatasetError(f"{url}: found another kind of URL, expected http:// or https://")
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(path.name + ".part")
    reason = ""
    for attempt in range(N_ATTEMPTS):
        before = _size(part)
        try:
            _fetch_rest(url, part, progress or (lambda done, total: None))
            break
        except _Cut as error:
            reason = str(error)
            if isinstance(error, _Unreachable) and attempt == 0:
                raise DatasetError(f"{url}: {reason}") from error
            logger.warning("%s: %s, %d bytes so far", url, reason, _size(part))
        if attempt < N_ATTEMPTS - 1 and _size(part) <= before:
            time.sleep(wait_s * 2**attempt)
    else:
        raise DatasetError(
            f"{url}: {reason} for the {N_ATTEMPTS}th time; {_size(part)} bytes are kept, "
            "the same command goes on from there"
        )
    part.replace(path)
    _notes(part).unlink(missing_ok=True)
    return True


def _fetch_rest(url: str, part: Path, progress: Progress) -> None:
    have, notes = _size(part), _read_notes(part)
    if have and not notes.get("version"):
        have = 0  # the version of these bytes is unknown
    try:
        request = urllib.request.Request(url, headers={"User-Agent": "slam-bof"})
        if have:
            request.add_header("Range", f"bytes={have}-")
            request.add_header("If-Range", notes["version"])
        with Watchdog(TIMEOUT_S, MIN_BYTES) as watchdog, open_url(request, watchdog) as answer:
            _receive(url, part, answer, have, watchdog, progress)
    except urllib.error.HTTPError as error:
        error.close()
        if error.code == http.HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE and have:
            match = CONTENT_RANGE.fullmatch(error.headers.get("Content-Range", ""))
            if match and int(match[2]) == have:
                return  # the file is complete, but was not renamed
            part.unlink()
            raise _Cut("found that the file has changed; starting again") from error
        if error.code in PASSING:
            raise _Cut(f"found {error.code} {printable(error.reason)}") from error
        found = f"{error.code} {printable(error.reason)}"
        raise DatasetError(f"{url}: found {found}, expected a file") from error
    except urllib.error.URLError as error:
        raise _Unreachable(f"cannot be reached ({printable(error.reason)})") from error
    except (ValueError, OverflowError, http.client.InvalidURL) as error:  # no server, no port
        raise DatasetError(f"{url}: {printable(error)}, expected an address") from error
    except (http.client.HTTPException, ConnectionError, TimeoutError) as error:
        raise _Cut(f"connection cut ({printable(error) or type(error).__name__})") from error


def _receive(
    url: str, part: Path, answer: Any, have: int, watchdog: Watchdog, progress: Progress
) -> None:
    length = _content_length(url, answer)
    if answer.status == http.HTTPStatus.PARTIAL_CONTENT:
        match = CONTENT_RANGE.fullmatch(answer.headers.get("Content-Range", ""))
        if match is None or match[1] is None or int(match[1]) != have:
            found = printable(answer.headers.get("Content-Range", "no range"))
            raise DatasetError(f"{url}: found {found}, expected bytes from {have}")
        total = int(match[2])
    else:
        have, total = 0, length
    _check_space(url, part, total - have)
    version = answer.headers.get("ETag", "")
    if not version or version.startswith("W/"):  # a weak tag may stand for other bytes
        version = answer.headers.get("Last-Modified", "")
    if not have:
        _notes(part).write_text(json.dumps({"url": url, "version": version}), encoding="utf-8")
    done = have
    with part.open("ab" if have else "wb") as file:
        progress(done, total)
        while chunk := answer.read1(CHUNK_BYTES):
            _check_space(url, part, len(chunk))  # others write to the disk, too
            file.write(chunk)
            done += len(chunk)
            watchdog.count(len(chunk))
            progress(done, total)
    if watchdog.has_cut:
        raise _Cut(f"found less than {MIN_BYTES} bytes in {TIMEOUT_S:g} s")
    if total and done > total:
        part.unlink()
        raise DatasetError(f"{url}: found {done} bytes, expected {total}")
    if done < total:
        raise _Cut(f"connection cut at {done} of {total} bytes")


def _content_length(url: str, answer: Any) -> int:
    """Return the length that the server says, 0 if it says none; it may repeat it (RFC 9110)."""
    lengths = set(re.split(r"\s*,\s*", (answer.headers.get("Content-Length") or "0").strip()))
    (length, *others) = lengths
    if others or not re.fullmatch(NUMBER, length):
        found = printable(answer.headers["Content-Length"])
        raise DatasetError(f"{url}: found Content-Length {found}, expected a number")
    return int(length)


def _check_space(url: str, part: Path, n_bytes: int) -> None:
    free = shutil.disk_usage(part.parent).free
    if n_bytes > free - MARGIN_BYTES:
        raise DatasetError(
            f"{part.parent}: found {free / 1e9:.1f} GB free, "
            f"expected {(n_bytes + MARGIN_BYTES) / 1e9:.1f} GB for {url}"
        )


def _size(part: Path) -> int:
    return part.stat().st_size if part.is_file() else 0


def _notes(part: Path) -> Path:
    return part.with_name(part.name + ".json")


def _read_notes(part: Path) -> dict[str, str]:
    try:
        notes = json.loads(read_text(_notes(part)))
    except (OSError, ValueError, RecursionError):
        return {}
    version = notes.get("version") if isinstance(notes, dict) else None
    is_version = isinstance(version, str) and version.isascii() and version.isprintable()
    return {"version": version} if version and is_version else {}
