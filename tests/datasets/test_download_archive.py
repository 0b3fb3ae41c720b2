"""What comes out of an archive, and what must not."""

from __future__ import annotations

import gzip
import io
import random
import struct
import tarfile
import tracemalloc
import zipfile
from pathlib import Path

import pytest
from archives import CHESS, UNPACKED, tarred, tree, zipped

from slam_bof.datasets.download_archive import BadArchive, Limits, unpack
from slam_bof.errors import DatasetError

CONTENT = bytes(range(256)) * 4000  # 1 MB: some chunks


def unpack_bytes(data: bytes, folder: Path, suffix: str = ".zip", **limits: float) -> None:
    archive = folder / f"a{suffix}"
    archive.write_bytes(data)
    unpack(archive, folder / "in" / "out", limits=Limits(**limits))


def test_zips_inside_are_unpacked_where_they_lie(tmp_path: Path) -> None:
    unpack_bytes(CHESS, tmp_path)
    assert tree(tmp_path / "in" / "out") == UNPACKED


def test_zips_from_windows_have_folders_too(tmp_path: Path) -> None:
    data = CHESS.replace(b"chess/", b"chess\\")
    unpack_bytes(data, tmp_path)
    assert tree(tmp_path / "in" / "out") == UNPACKED


def test_tarballs_are_unpacked(tmp_path: Path) -> None:
    files = {"a/depth.txt": b"1.0 x.png", "a/depth/x.png": CONTENT}
    unpack_bytes(tarred(files), tmp_path, ".tgz")
    assert tree(tmp_path / "in" / "out") == files


OUTSIDE = ["../x", "a/../../x", "/x", "\\x", "..\\x", "C:/x", "C:x", "a/..\\..\\x"]


@pytest.mark.parametrize("name", OUTSIDE)
@pytest.mark.parametrize("form", ["zip", "nested", "tar"])
def test_no_path_leaves_the_folder(tmp_path: Path, name: str, form: str) -> None:
    files = {"good": b"1", name: b"evil"}
    data = tarred(files) if form == "tar" else zipped(files)
    if form == "nested":
        data = zipped({"a/b.zip": data})
    with pytest.raises(BadArchive, match="found a path that leads elsewhere"):
        unpack_bytes(data, tmp_path, ".tgz" if form == "tar" else ".zip")
    assert b"evil" not in [
        file.read_bytes() for file in tmp_path.rglob("*") if file.is_file() and file.name[0] == "x"
    ]


def test_no_links_come_out(tmp_path: Path) -> None:
    with pytest.raises(BadArchive, match="found a link or device: 'l'"):
        unpack_bytes(zipped({"a": b""}, link="l"), tmp_path)
    for kind in (tarfile.SYMTYPE, tarfile.LNKTYPE, tarfile.CHRTYPE, tarfile.FIFOTYPE):
        with pytest.raises(BadArchive, match="found a link or device: 'link'"):
            unpack_bytes(tarred({}, link=kind), tmp_path, ".tgz")
    assert not any(file.is_symlink() for file in tmp_path.rglob("*"))


@pytest.mark.parametrize("form", ["zip", "nested", "tar"])
def test_bombs_do_not_go_off(tmp_path: Path, form: str) -> None:
    files = {"zeros": bytes(2_000_000)}
    data = tarred(files) if form == "tar" else zipped(files)
    if form == "nested":
        data = zipped({"a.zip": data})
    suffix = ".tgz" if form == "tar" else ".zip"
    with pytest.raises(BadArchive, match="expected a data set, not a bomb"):
        unpack_bytes(data, tmp_path, suffix, free_of_ratio_bytes=1_000_000)
    assert not list(tmp_path.rglob("zeros"))
    with pytest.raises(BadArchive, match="found more than 2 entries"):
        unpack_bytes(zipped({str(i): b"" for i in range(3)}), tmp_path, n_entries=2)


def test_a_disk_too_small_is_told_before(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="which the disk can take") as caught:
        unpack_bytes(zipped({"x": b"1"}), tmp_path, margin_bytes=10**18)
    assert not isinstance(caught.value, BadArchive)


def flip(data: bytes) -> bytes:
    at = data.index(b"PK\3\4") + 45
    return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("data", "suffix"),
    [
        (CHESS[: len(CHESS) // 2], ".zip"),
        (b"", ".zip"),
        (b"<html>not found</html>", ".zip"),
        (flip(zipped({"chess/x": CONTENT})), ".zip"),
        (zipped({"a.zip": flip(zipped({"chess/x": CONTENT}))}), ".zip"),
        (tarred({"a": CONTENT})[:-20], ".tgz"),
        (tarred({"a": CONTENT})[:-8] + bytes(8), ".tgz"),
        (tarred({"a": CONTENT})[:3000], ".tgz"),
        (b"<html>not found</html>", ".tgz"),
        (b"", ".tgz"),
    ],
)
def test_damage_is_found(tmp_path: Path, data: bytes, suffix: str) -> None:
    with pytest.raises(BadArchive, match=r"a\.(zip|tgz): found damage \(") as caught:
        unpack_bytes(data, tmp_path, suffix)
    assert "\n" not in str(caught.value)


def test_a_locked_zip_is_told(tmp_path: Path) -> None:
    data = bytearray(zipped({"x": b"1"}))
    for magic, at in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        start = data.index(magic) + at
        data[start : start + 2] = struct.pack("<H", 1)
    with pytest.raises(BadArchive, match=r"cannot be unpacked: .*password"):
        unpack_bytes(bytes(data), tmp_path)


def bomb(n_levels: int, n_zips: int, n_bytes: int) -> bytes:
    """Each of the inner archives stays below every limit for itself."""
    if n_levels == 0:
        return zipped({"zeros": bytes(n_bytes)})
    return zipped({f"{k}.zip": bomb(n_levels - 1, n_zips, n_bytes) for k in range(n_zips)})


def test_bombs_within_an_archive_count_together(tmp_path: Path) -> None:
    data = bomb(1, 30, 900_000)
    assert len(data) < 50_000
    with pytest.raises(BadArchive, match="expected a data set, not a bomb"):
        unpack_bytes(data, tmp_path)
    assert sum(file.stat().st_size for file in tmp_path.rglob("zeros")) < 10_000_000
    with pytest.raises(BadArchive, match="found more than 40 entries"):
        unpack_bytes(bomb(1, 30, 1), tmp_path, n_entries=40)


def header(name: str, size: bytes, kind: bytes = tarfile.REGTYPE) -> bytes:
    """Return the header of a tar's entry whose size has these bytes."""
    entry = tarfile.TarInfo(name)
    entry.type = kind
    data = bytearray(entry.tobuf(tarfile.USTAR_FORMAT))
    data[124:136] = size
    data[148:156] = b" " * 8
    data[148:156] = b"%06o\0 " % sum(data)
    return bytes(data)


def octal(size: int) -> bytes:
    return b"%011o\0" % size


BACK = b"\xff" + ((1 << 88) - 512).to_bytes(11, "big")
"""A size of -512 bytes, in base 256: the next entry would be this one again."""
TARS = {
    "a negative size": header("a/x", octal(512)) + bytes(512) + header("a/b", BACK),
    "a negative name": header("././@LongLink", BACK, tarfile.GNUTYPE_LONGNAME),
    "a pax header of 4 GB": header("p", octal(4 << 30), tarfile.XHDTYPE) + bytes(1 << 20),
    "a name of 3 GB": header("l", octal(3 << 30), tarfile.GNUTYPE_LONGNAME) + bytes(1 << 20),
    "a size of terabytes": header("a/x", b"\x80" + (1 << 50).to_bytes(11, "big")),
    "headers on headers": header("p", octal(0), tarfile.XHDTYPE) * 3000,
    "a pax header of nonsense": header("p", octal(512), tarfile.XHDTYPE)
    + b"99999999999 path=x\n".ljust(512, b"\0"),
}


@pytest.mark.parametrize("case", TARS)
def test_a_tar_that_lies_about_sizes_is_refused_at_once(tmp_path: Path, case: str) -> None:
    tracemalloc.start()
    with pytest.raises(BadArchive) as caught:
        unpack_bytes(gzip.compress(TARS[case] + bytes(1024), 1), tmp_path, ".tgz")
    _, peak_bytes = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "\n" not in str(caught.value)
    assert peak_bytes < 50_000_000


@pytest.mark.parametrize("kind", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_compression_that_no_data_set_has_is_refused(tmp_path: Path, kind: int) -> None:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", kind) as packed:
        packed.writestr("x", b"1")
    with pytest.raises(BadArchive, match=r"a\.zip: cannot be unpacked: found compression 1"):
        unpack_bytes(data.getvalue(), tmp_path)


def test_a_name_in_no_coding_is_damage(tmp_path: Path) -> None:
    data = zipped({"\u00e9\u00e9": b"1"}).replace("\u00e9\u00e9".encode(), b"\xff\xfe\xff\xfe")
    with pytest.raises(BadArchive, match=r"found damage \("):
        unpack_bytes(data, tmp_path)


@pytest.mark.parametrize("form", ["zip", "tar"])
def test_whatever_byte_is_wrong_the_answer_is_one_line(tmp_path: Path, form: str) -> None:
    rng = random.Random(form)
    files = {"chess/a.txt": b"1.0 x.png" * 40, "chess/b/x.png": CONTENT[:3000]}
    data = zipped(files) if form == "zip" else tarred(files)
    for number in range(300):
        broken = bytearray(data)
        for _ in range(rng.randrange(1, 4)):
            broken[rng.randrange(len(broken))] = rng.randrange(256)
        folder = tmp_path / str(number)
        folder.mkdir()
        said = ""
        try:
            unpack_bytes(bytes(broken), folder, ".zip" if form == "zip" else ".tgz")
        except DatasetError as error:
            said = str(error)
        assert "\n" not in said
        assert len(said) < 600
