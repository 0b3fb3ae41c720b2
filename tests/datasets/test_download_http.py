"""Downloading a file from a server of our own: whole, cut, resumed, and refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from web_server import Server

from slam_bof.datasets.download_http import fetch
from slam_bof.errors import DatasetError

CONTENT = bytes(range(256)) * 12000  # 3 MB: some chunks


@pytest.fixture
def path(server: Server, tmp_path: Path) -> Path:
    """Where to put the file that the server has."""
    server.files["a.bin"] = CONTENT
    return tmp_path / "a.bin"


def get(server: Server, path: Path) -> bool:
    return fetch(f"{server.url}/a.bin", path, wait_s=0.0)


def check_arrives(server: Server, path: Path) -> None:
    assert get(server, path)
    assert path.read_bytes() == server.files["a.bin"]


def refused(server: Server, path: Path) -> str:
    with pytest.raises(DatasetError) as caught:
        get(server, path)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_a_file_comes_whole_and_only_once(server: Server, path: Path) -> None:
    told: list[tuple[int, int]] = []
    path = path.parent / "deep" / "a.bin"
    assert fetch(f"{server.url}/a.bin", path, progress=lambda *n: told.append(n))
    assert path.read_bytes() == CONTENT
    assert [file.name for file in path.parent.iterdir()] == ["a.bin"]
    assert told[0] == (0, len(CONTENT))
    assert told[-1] == (len(CONTENT), len(CONTENT))
    assert not get(server, path)
    assert len(server.asked) == 1


def test_a_cut_connection_goes_on_where_it_stopped(server: Server, path: Path) -> None:
    server.cut_after = [1_000_000, 500_000]
    check_arrives(server, path)
    assert [wanted for _, wanted in server.asked] == ["", "bytes=1000000-", "bytes=1500000-"]
    assert server.sent == len(CONTENT)


def test_what_a_killed_call_left_is_taken_up(server: Server, path: Path) -> None:
    server.cut_after = [200_000, 0, 0, 0, 0]
    said = refused(server, path)
    assert "connection cut at 200000 of 3072000 bytes for the 5th time" in said
    assert "200000 bytes are kept" in said
    assert not path.exists()
    server.asked.clear()
    check_arrives(server, path)
    assert server.asked == [("/a.bin", "bytes=200000-")]


def test_without_ranges_all_is_sent_again(server: Server, path: Path) -> None:
    server.ranges = False
    server.cut_after = [1_000_000]
    check_arrives(server, path)
    assert server.sent == len(CONTENT) + 1_000_000


def test_a_download_without_version_is_not_resumed(server: Server, path: Path) -> None:
    server.version = ""
    server.cut_after = [1_000_000]
    check_arrives(server, path)
    assert [wanted for _, wanted in server.asked] == ["", ""]


def test_a_file_that_changed_meanwhile_is_not_mixed(server: Server, path: Path) -> None:
    server.cut_after = [1_000_000, 0, 0, 0, 0]
    refused(server, path)
    server.files["a.bin"] = CONTENT[::-1]
    server.version = '"v2"'
    check_arrives(server, path)


@pytest.mark.parametrize(("more", "n_sent"), [(b"", 0), (b"more", len(CONTENT))])
def test_a_part_with_all_or_more_of_it(
    server: Server, path: Path, more: bytes, n_sent: int
) -> None:
    """All that was missing was the name; with more, it begins anew."""
    part = path.with_name("a.bin.part")
    part.write_bytes(CONTENT + more)
    part.with_name("a.bin.part.json").write_text(json.dumps({"version": server.version}))
    check_arrives(server, path)
    assert server.sent == n_sent


def test_a_wrong_size_is_told(server: Server, path: Path) -> None:
    server.declared = len(CONTENT) + 5
    server.ranges = False
    assert "connection cut at 3072000 of 3072005 bytes" in refused(server, path)
    assert not path.exists()


def test_a_busy_server_is_asked_again(server: Server, path: Path) -> None:
    server.statuses = [503, 429]
    check_arrives(server, path)
    assert len(server.asked) == 3


def test_what_is_not_there_is_told_at_once(server: Server, path: Path) -> None:
    server.files.clear()
    said = refused(server, path)
    assert f"{server.url}/a.bin: found 404 Not Found, expected a file" in said
    assert len(server.asked) == 1
    with pytest.raises(DatasetError, match=r"cannot be reached .*refused"):
        fetch("http://127.0.0.1:9/a", path)
    with pytest.raises(DatasetError, match="expected http:// or https://"):
        fetch("file:///etc/passwd", path)


def test_a_full_disk_is_told_before(
    server: Server, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slam_bof.datasets.download_http.MARGIN_BYTES", 10**18)
    assert "GB free, expected" in refused(server, path)
    assert list(path.parent.iterdir()) == []
