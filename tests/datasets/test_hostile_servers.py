"""Servers that never end, dribble, lead elsewhere or send garbage."""

from __future__ import annotations

import socket
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from slam_bof.datasets import download_http
from slam_bof.datasets.download_connection import _StayEncrypted
from slam_bof.datasets.download_http import fetch
from slam_bof.errors import DatasetError

Answer = Callable[[socket.socket], None]


@contextmanager
def answering(answer: Answer) -> Iterator[str]:
    """Answer every request, byte for byte; yield the URL."""
    with closing(socket.create_server(("127.0.0.1", 0))) as server:

        def serve() -> None:
            while True:
                try:
                    connection, _ = server.accept()
                except OSError:
                    return
                with closing(connection), suppress(OSError):
                    connection.recv(65536)
                    answer(connection)

        threading.Thread(target=serve, daemon=True).start()
        yield f"http://127.0.0.1:{server.getsockname()[1]}/a.bin"
        server.shutdown(socket.SHUT_RDWR)


def refused(answer: Answer, path: Path) -> str:
    with answering(answer) as url, pytest.raises(DatasetError) as caught:
        fetch(url, path, wait_s=0.0)
    message = str(caught.value)
    assert message.isprintable()
    assert len(message) < 500
    return message


def says(*lines: str, body: bytes = b"") -> Answer:
    head = "\r\n".join(("HTTP/1.1 200 OK", *lines, "", "")).encode("latin-1")
    return lambda connection: connection.sendall(head + body)


def test_an_endless_body_leaves_room_on_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    part = tmp_path / "a.bin.part"

    def free(folder: Path) -> SimpleNamespace:
        size = part.stat().st_size if part.exists() else 0
        return SimpleNamespace(free=download_http.MARGIN_BYTES + 5_000_000 - size)

    def endless(connection: socket.socket) -> None:
        connection.sendall(b"HTTP/1.1 200 OK\r\n\r\n")
        while True:
            connection.sendall(bytes(1 << 16))

    monkeypatch.setattr(download_http.shutil, "disk_usage", free)
    assert "GB free, expected" in refused(endless, tmp_path / "a.bin")
    assert part.stat().st_size <= 5_000_000


def dribble_body(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nContent-Length: 900000\r\n\r\n")
    while True:
        connection.sendall(b"x")
        time.sleep(0.02)


def dribble_head(connection: socket.socket) -> None:
    connection.sendall(b"HTTP/1.1 200 OK\r\nX: ")
    while True:
        connection.sendall(b"x")
        time.sleep(0.02)


@pytest.mark.parametrize("dribble", [dribble_body, dribble_head])
def test_a_server_that_dribbles_is_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dribble: Answer
) -> None:
    monkeypatch.setattr(download_http, "TIMEOUT_S", 0.3)
    monkeypatch.setattr(download_http, "N_ATTEMPTS", 2)
    start = time.monotonic()
    assert "for the 2th time" in refused(dribble, tmp_path / "a.bin")
    assert time.monotonic() - start < 5.0


@pytest.mark.parametrize("length", ["5", "5, 5", "5,5 ", ""])
def test_a_length_may_be_repeated(tmp_path: Path, length: str) -> None:
    with answering(says(f"Content-Length: {length}", body=b"hello")) as url:
        assert fetch(url, tmp_path / "a.bin")
    assert (tmp_path / "a.bin").read_bytes() == b"hello"


@pytest.mark.parametrize("length", ["5, 6", "five", "-5", "9" * 5000, "5\x1b[31m"])
def test_a_length_that_is_none_is_refused(tmp_path: Path, length: str) -> None:
    message = refused(says(f"Content-Length: {length}", body=b"hello"), tmp_path / "a.bin")
    assert "found Content-Length" in message


@pytest.mark.parametrize(
    "target",
    ["ftp://a/b", "file:///etc/passwd", "http://[", "gopher:x\x1b[1m", f"http://[::1]:{'9' * 30}/"],
)
def test_a_redirect_to_something_else_is_refused(tmp_path: Path, target: str) -> None:
    def answer(connection: socket.socket) -> None:
        connection.sendall(f"HTTP/1.1 302 Found\r\nLocation: {target}\r\n\r\n".encode())

    assert "expected" in refused(answer, tmp_path / "a.bin")


def test_https_is_not_left(tmp_path: Path) -> None:
    request = urllib.request.Request("https://a.org/x")
    redirect = _StayEncrypted().redirect_request
    with pytest.raises(DatasetError, match=r"https://a\.org/x: found a redirect to http://b\.org"):
        redirect(request, None, 302, "Found", {}, "http://b.org/x")
    followed = redirect(request, None, 302, "Found", {}, "https://b.org/x")
    assert followed is not None
    assert followed.full_url == "https://b.org/x"


def test_a_server_that_sends_garbage_is_one_printable_line(tmp_path: Path) -> None:
    garbage = b"HTTP/1.1 404 \x1b[31mgone\x07\tfor\x00 ever\x85" + b"!" * 5000 + b"\r\n\r\n"
    message = refused(lambda c: c.sendall(garbage), tmp_path / "a.bin")
    assert "found 404 [31mgone" in message
    refused(lambda c: c.sendall(b"\x00\x1b[2J\n\n" * 100), tmp_path / "b.bin")


@pytest.mark.parametrize(
    "url", ["http://[::1/x", f"http://{'a' * 70}.org/x", "http://a b/x", "http://a\nb/x", "http://"]
)
def test_a_name_that_no_server_has_is_refused(tmp_path: Path, url: str) -> None:
    with pytest.raises(DatasetError) as caught:
        fetch(url, tmp_path / "a.bin", wait_s=0.0)
    assert len(str(caught.value)) < 300
    assert caught.value.__cause__ is not None


def test_notes_of_anything_are_ignored(tmp_path: Path) -> None:
    for notes in ("[", "[1]", '{"version": "a\\r\\nX: y"}', '{"version": {}}', "[" * 5000):
        (tmp_path / "a.bin.part").write_bytes(b"hel")
        (tmp_path / "a.bin.part.json").write_text(notes)
        with answering(says("Content-Length: 5", body=b"hello")) as url:
            assert fetch(url, tmp_path / "a.bin")
        assert (tmp_path / "a.bin").read_bytes() == b"hello"
        (tmp_path / "a.bin").unlink()
