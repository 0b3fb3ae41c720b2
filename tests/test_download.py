"""Downloading from a server of our own: whole, cut, resumed, and what must not be unpacked."""

from __future__ import annotations

import http.server
import io
import json
import stat
import struct
import tarfile
import threading
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from slam_bof.cli import app
from slam_bof.download import download
from slam_bof.download_archive import BadArchive, Limits, unpack
from slam_bof.download_catalogue import CATALOGUE, find_archives
from slam_bof.download_http import fetch
from slam_bof.errors import DatasetError

CONTENT = bytes(range(256)) * 12000  # 3 MB: some chunks


@dataclass
class Server:
    """What the server has and how it misbehaves, and what it was asked."""

    files: dict[str, bytes] = field(default_factory=dict)
    url: str = ""
    version: str = '"v1"'
    ranges: bool = True
    cut_after: list[int] = field(default_factory=list)
    """After how many bytes to cut the connection, answer by answer."""
    declared: int | None = None
    statuses: list[int] = field(default_factory=list)
    """What to answer in place of the file, answer by answer."""
    asked: list[tuple[str, str]] = field(default_factory=list)
    """Path and Range of each request."""
    sent: int = 0


class Handler(http.server.BaseHTTPRequestHandler):
    server_state: Server
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        state = self.server_state
        wanted = self.headers.get("Range", "")
        state.asked.append((self.path, wanted))
        self.close_connection = True
        data = state.files.get(self.path.lstrip("/"))
        if state.statuses or data is None:
            self.send_error(state.statuses.pop(0) if state.statuses else 404)
            return
        start = 0
        if wanted and state.ranges and self.headers.get("If-Range") == state.version:
            start = int(wanted.removeprefix("bytes=").rstrip("-"))
            if start >= len(data):
                self.send_response(416)
                self.send_header("Content-Range", f"bytes */{len(data)}")
                self.send_header("Content-Length", "0")
                self.end_headers()
                return
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{len(data) - 1}/{len(data)}")
        else:
            self.send_response(200)
        body = data[start:]
        if state.version:
            self.send_header("ETag", state.version)
        self.send_header("Content-Length", str(state.declared or len(body)))
        self.end_headers()
        if state.cut_after:
            body = body[: state.cut_after.pop(0)]
        state.sent += len(body)
        self.wfile.write(body)

    def log_message(self, *arguments: object) -> None:
        """Say nothing."""


@pytest.fixture
def server() -> Iterator[Server]:
    state = Server()
    handler = type("H", (Handler,), {"server_state": state})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        state.url = f"http://127.0.0.1:{running.server_address[1]}"
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield state
        running.shutdown()
        thread.join()


def get(server: Server, path: Path) -> bool:
    return fetch(f"{server.url}/a.bin", path, wait_s=0.0)


def refused(server: Server, path: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        get(server, path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


# One file


def test_a_file_comes_whole_and_only_once(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    told: list[tuple[int, int]] = []
    path = tmp_path / "deep" / "a.bin"
    assert fetch(f"{server.url}/a.bin", path, progress=lambda *n: told.append(n))
    assert path.read_bytes() == CONTENT
    assert [file.name for file in path.parent.iterdir()] == ["a.bin"]
    assert told[0] == (0, len(CONTENT))
    assert told[-1] == (len(CONTENT), len(CONTENT))
    assert not get(server, path)
    assert len(server.asked) == 1


def test_a_cut_connection_goes_on_where_it_stopped(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.cut_after = [1_000_000, 500_000]
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT
    assert [wanted for _, wanted in server.asked] == ["", "bytes=1000000-", "bytes=1500000-"]
    assert server.sent == len(CONTENT)


def test_what_a_killed_call_left_is_taken_up(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.cut_after = [200_000, 0, 0, 0, 0]
    said = refused(server, tmp_path / "a.bin")
    assert "connection cut at 200000 of 3072000 bytes for the 5th time" in said
    assert "200000 bytes are kept" in said
    assert not (tmp_path / "a.bin").exists()
    server.asked.clear()
    get(server, tmp_path / "a.bin")
    assert server.asked == [("/a.bin", "bytes=200000-")]
    assert (tmp_path / "a.bin").read_bytes() == CONTENT


def test_without_ranges_all_comes_anew(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.ranges = False
    server.cut_after = [1_000_000]
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT
    assert server.sent == len(CONTENT) + 1_000_000


def test_a_server_that_tells_no_version_is_not_resumed(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.version = ""
    server.cut_after = [1_000_000]
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT
    assert [wanted for _, wanted in server.asked] == ["", ""]


def test_a_file_that_changed_meanwhile_is_not_mixed(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.cut_after = [1_000_000, 0, 0, 0, 0]
    refused(server, tmp_path / "a.bin")
    server.files["a.bin"] = CONTENT[::-1]
    server.version = '"v2"'
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT[::-1]


def test_all_that_was_missing_was_the_name(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    (tmp_path / "a.bin.part").write_bytes(CONTENT)
    (tmp_path / "a.bin.part.json").write_text(json.dumps({"version": server.version}))
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT
    assert server.sent == 0


def test_more_than_there_is_begins_anew(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    (tmp_path / "a.bin.part").write_bytes(CONTENT + b"more")
    (tmp_path / "a.bin.part.json").write_text(json.dumps({"version": server.version}))
    get(server, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == CONTENT


def test_a_wrong_size_is_told(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.declared = len(CONTENT) + 5
    server.ranges = False
    assert "connection cut at 3072000 of 3072005 bytes" in refused(server, tmp_path / "a.bin")
    assert not (tmp_path / "a.bin").exists()


def test_a_busy_server_is_asked_again(server: Server, tmp_path: Path) -> None:
    server.files["a.bin"] = CONTENT
    server.statuses = [503, 429]
    get(server, tmp_path / "a.bin")
    assert len(server.asked) == 3


def test_what_is_not_there_is_told_at_once(server: Server, tmp_path: Path) -> None:
    said = refused(server, tmp_path / "a.bin")
    assert f"{server.url}/a.bin: found 404 Not Found, expected a file" in said
    assert len(server.asked) == 1
    with pytest.raises(DatasetError, match=r"cannot be reached .*refused"):
        fetch("http://127.0.0.1:9/a", tmp_path / "a")
    with pytest.raises(DatasetError, match="expected http:// or https://"):
        fetch("file:///etc/passwd", tmp_path / "a")


def test_a_full_disk_is_told_before(
    server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    server.files["a.bin"] = CONTENT
    monkeypatch.setattr("slam_bof.download_http.MARGIN_BYTES", 10**18)
    assert "GB free, expected" in refused(server, tmp_path / "a.bin")
    assert list(tmp_path.iterdir()) == []


# Archives


def zipped(files: dict[str, bytes], *, link: str = "") -> bytes:
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", zipfile.ZIP_DEFLATED) as packed:
        for name, content in files.items():
            packed.writestr(name, content)
        if link:
            entry = zipfile.ZipInfo(link)
            entry.external_attr = (stat.S_IFLNK | 0o777) << 16
            packed.writestr(entry, "/etc/passwd")
    return data.getvalue()


def tarred(files: dict[str, bytes], *, link: bytes = b"", name: str = "link") -> bytes:
    data = io.BytesIO()
    with tarfile.open(fileobj=data, mode="w:gz") as packed:
        for path, content in files.items():
            entry = tarfile.TarInfo(path)
            entry.size = len(content)
            packed.addfile(entry, io.BytesIO(content))
        if link:
            entry = tarfile.TarInfo(name)
            entry.type = link
            entry.linkname = "../../outside"
            packed.addfile(entry)
    return data.getvalue()


CHESS = zipped(
    {
        "chess/TrainSplit.txt": b"sequence1\n",
        "chess/seq-01.zip": zipped(
            {"seq-01/frame-000000.depth.png": b"depth", "seq-01/frame-000000.pose.txt": b"pose"}
        ),
        "chess/seq-02.zip": zipped({"seq-02/frame-000000.depth.png": b"other"}),
    }
)


def tree(folder: Path) -> dict[str, bytes]:
    return {
        str(file.relative_to(folder)): file.read_bytes()
        for file in sorted(folder.rglob("*"))
        if file.is_file()
    }


UNPACKED = {
    "chess/TrainSplit.txt": b"sequence1\n",
    "chess/seq-01/frame-000000.depth.png": b"depth",
    "chess/seq-01/frame-000000.pose.txt": b"pose",
    "chess/seq-02/frame-000000.depth.png": b"other",
}


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


# The whole way


def test_a_scene_is_downloaded_once(server: Server, tmp_path: Path) -> None:
    server.files["chess.zip"] = CHESS
    (found,) = download("7scenes", "chess", tmp_path, base_url=f"{server.url}/")
    assert (found.folder, found.was_there) == (tmp_path / "7scenes" / "chess", False)
    assert tree(tmp_path / "7scenes") == UNPACKED
    (again,) = download("7scenes", "chess", tmp_path, base_url=server.url)
    assert again.was_there
    assert len(server.asked) == 1


def test_the_archive_is_kept_on_demand_and_used_again(server: Server, tmp_path: Path) -> None:
    server.files["rgbd_dataset_freiburg1_desk.tgz"] = tarred(
        {"rgbd_dataset_freiburg1_desk/depth.txt": b"#"}
    )
    options = {"base_url": server.url, "keep_archive": True}
    (found,) = download("tum", "fr1/desk", tmp_path, **options)
    (found.folder / "depth.txt").unlink()
    found.folder.rmdir()
    (found,) = download("tum", "fr1/desk", tmp_path, **options)
    assert (found.folder / "depth.txt").is_file()
    assert len(server.asked) == 1


def test_a_bad_archive_is_set_aside(server: Server, tmp_path: Path) -> None:
    for bad in (CHESS[:300], zipped({"fire/x": b"1"}), zipped({"../chess/x": b"1"})):
        server.files["chess.zip"] = bad
        with pytest.raises(DatasetError, match=r"; set aside as chess\.zip\.bad"):
            download("7scenes", "chess", tmp_path, base_url=server.url)
        assert [file.name for file in tmp_path.rglob("*")] == ["7scenes", "chess.zip.bad"]
    server.files["chess.zip"] = CHESS
    download("7scenes", "chess", tmp_path, base_url=server.url)
    assert (tmp_path / "7scenes" / "chess" / "seq-02").is_dir()


def test_the_catalogue_has_the_official_places() -> None:
    assert list(CATALOGUE["7scenes"].parts) == [
        "chess", "fire", "heads", "office", "pumpkin", "redkitchen", "stairs"
    ]  # fmt: skip
    (desk,) = find_archives("tum", "fr1/desk")
    assert desk.url == (
        "https://cvg.cit.tum.de/rgbd/dataset/freiburg1/rgbd_dataset_freiburg1_desk.tgz"
    )
    assert [archive.folder for archive in find_archives("sunrgbd")] == ["SUNRGBD", "SUNRGBDtoolbox"]
    for collection in CATALOGUE.values():
        assert collection.licence
        for archives in collection.parts.values():
            assert all(archive.url.startswith("https://") for archive in archives)


# The command


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


def test_the_command_shows_the_licence_and_what_to_do_next(server: Server, tmp_path: Path) -> None:
    server.files["chess.zip"] = CHESS
    common = ("download", "7scenes", "chess", "-o", tmp_path, "--base-url", server.url)
    result = run(*common)
    assert result.exit_code == 0, result.output
    assert result.stdout == f"{tmp_path / '7scenes' / 'chess'}\n"
    assert "non-commercial research only" in result.stderr
    assert "Downloading chess.zip (MB): 0/0" in result.stderr
    result = run(*common, "--json", "--quiet")
    assert result.stderr == ""
    assert json.loads(result.stdout) == [
        {"folder": str(tmp_path / "7scenes" / "chess"), "was_there": True}
    ]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["7scene", "chess"], "no data set '7scene' to download; did you mean '7scenes'?"),
        (["7scenes", "chest"], "7scenes: no part 'chest'; did you mean 'chess'?"),
        (["7scenes"], "7scenes: which part? one of: chess, fire, heads"),
        (["tum", "fr1/desk", "fr9/x"], "tum: no part 'fr9/x'"),
    ],
)
def test_the_command_says_what_there_is(arguments: list[str], message: str, tmp_path: Path) -> None:
    result = run("download", *arguments, "-o", tmp_path)
    assert result.exit_code == 1
    assert message in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_without_arguments_the_command_lists_all() -> None:
    assert "fr3/long_office_household" in run("download").stdout
    assert json.loads(run("download", "--json").stdout)["7scenes"][0] == "chess"
