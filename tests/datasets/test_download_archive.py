"""What comes out of an archive, and what must not."""

from __future__ import annotations

import struct
import tarfile
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
