"""Archives that were downloaded, with others in them and lies in their headers."""

from __future__ import annotations

import io
import random
import tarfile
import zipfile
import zlib
from functools import cache
from pathlib import Path

from fuzzing.cases import Reader, expect, nothing
from fuzzing.mutations import mutate_bytes
from slam_bof.datasets.download_archive import unpack

__all__ = ["READERS"]


def mutate_archive(place: Path, case: Path, rng: random.Random) -> None:
    """Make an archive with others in it, and lie in it."""
    inner = zipped({f"seq/{k}.txt": rng.randbytes(40) for k in range(3)}, rng)
    if rng.random() < 0.15:
        inner = bomb()
    n_inner = 30 if rng.random() < 0.1 else 2
    files = {f"chess/{k}.zip": inner for k in range(n_inner)} | {"chess/a.txt": b"a" * 900}
    if rng.random() < 0.5:
        data, name = zipped(files, rng), "a.zip"
    else:
        data, name = tarred(files, rng), "a.tgz"
    (case / name).write_bytes(mutate_bytes(data, rng) if rng.random() < 0.9 else data)


def zipped(files: dict[str, bytes], rng: random.Random) -> bytes:
    """Return a zip in some compression."""
    file = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_DEFLATED,) * 8 + (zipfile.ZIP_STORED, zipfile.ZIP_LZMA))
    with zipfile.ZipFile(file, "w", kind) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    return file.getvalue()


@cache
def bomb() -> bytes:
    """Return an archive of 20 kB that becomes 18 MB."""
    return zipped({str(k): bytes(9_000_000) for k in range(2)}, random.Random(0))


def tarred(files: dict[str, bytes], rng: random.Random) -> bytes:
    """Return a gzipped tar, whose bytes are changed before they are packed."""
    file = io.BytesIO()
    form = rng.choice((tarfile.PAX_FORMAT, tarfile.GNU_FORMAT, tarfile.USTAR_FORMAT))
    with tarfile.open(fileobj=file, mode="w", format=form) as archive:
        for name, data in files.items():
            entry = tarfile.TarInfo(name)
            entry.size = len(data)
            if form == tarfile.PAX_FORMAT and rng.random() < 0.3:
                entry.pax_headers = {"comment": "x" * 3000}
            archive.addfile(entry, io.BytesIO(data))
    data = bytearray(file.getvalue())
    for _ in range(rng.randrange(3)):
        start = 512 * rng.randrange(len(data) // 512)
        at = start + rng.choice((0, 100, 124, 124, 124, 156, 257))
        size = rng.choice((b"\xff" * 12, b"\x80" + bytes(7) + b"\x01\0\0\0", b"77777777777\0"))
        value = rng.choice((size, size, size, b"L", b"x", b"g", b"5"))
        data[at : at + len(value)] = value
        head = data[start : start + 512]
        head[148:156] = b" " * 8
        data[start + 148 : start + 156] = b"%06o\0 " % sum(head)
    compressor = zlib.compressobj(1, wbits=31)
    return compressor.compress(bytes(data)) + compressor.flush()


def read_archive(place: Path, case: Path) -> None:
    """Unpack an archive; it may not become a hundred times its size, nor leave its folder."""
    (archive,) = case.iterdir()
    out = case / "in" / "out"
    try:
        unpack(archive, out)
    finally:
        size = sum(file.stat().st_size for file in out.rglob("*") if file.is_file())
        expect(size <= max(100 * archive.stat().st_size, 10_000_000), f"{size} bytes came out")
        outside = [path.name for path in (case / "in").iterdir() if path != out]
        expect(not outside, f"{outside} outside")


READERS = {"archive": Reader(14, nothing, mutate_archive, read_archive)}
