"""SHA-256 of archives: none of the sources publishes any, so that of the first download counts.

``SHA256SUMS`` beside the data sets has them in the format of ``sha256sum``. It may be written
before the download, from a source that is trusted.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

from slam_bof.core import open_bytes, read_text
from slam_bof.errors import DatasetError

__all__ = ["check_sum", "record_sum"]

SUMS = "SHA256SUMS"
LINE = re.compile(r"([0-9a-fA-F]{64}) [ *](.+)")


def check_sum(archive: Path) -> str:
    """Return the SHA-256 of an archive; ``DatasetError`` if another one is recorded."""
    with open_bytes(archive) as file:
        found = hashlib.file_digest(file, "sha256").hexdigest()
    expected = _read_sums(archive.with_name(SUMS)).get(archive.name, found)
    if found != expected:
        raise DatasetError(
            f"{archive}: found SHA-256 {found}, expected {expected} as {SUMS} has it; if the "
            "source has changed the file, remove that line"
        )
    return found


def record_sum(archive: Path, sha256: str) -> None:
    """Record the SHA-256 of an archive, unless there is one."""
    sums = archive.with_name(SUMS)
    if archive.name not in _read_sums(sums):
        with sums.open("a", encoding="utf-8", newline="\n") as file:
            file.write(f"{sha256}  {archive.name}\n")


def _read_sums(sums: Path) -> dict[str, str]:
    """Return SHA-256 by the name of the file; other lines are ignored."""
    try:
        lines = read_text(sums, "replace").splitlines()
    except OSError:
        return {}
    found = (LINE.fullmatch(line) for line in lines)
    return {match[2]: match[1].lower() for match in found if match}
