"""What servers answer to a download."""

from __future__ import annotations

import random
import socket
import threading
from contextlib import closing
from pathlib import Path

from fuzzing.cases import Reader, expect, nothing
from fuzzing.mutations import mutate_bytes, mutate_text
from slam_bof.datasets import download_http
from slam_bof.errors import DatasetError

__all__ = ["READERS"]

ANSWER = (
    b"HTTP/1.1 200 OK\r\nContent-Length: 64\r\nETag: \"v1\"\r\nContent-Range: bytes 0-63/64\r\n"
    b"Location: http://127.0.0.1:9/x\r\nTransfer-Encoding: identity\r\n\r\n" + bytes(range(64))
)  # fmt: skip


def mutate_answer(place: Path, case: Path, rng: random.Random) -> None:
    """Change what a server answers."""
    data = ANSWER.replace(
        b"200", str(rng.choice((200, 200, 206, 302, 404, 503, 416, 100))).encode()
    )
    data = data.replace(b"identity", rng.choice((b"identity", b"chunked", b"gzip")))
    head, _, body = data.partition(b"\r\n\r\n")
    for _ in range(rng.choice((1, 2))):
        if rng.random() < 0.6:
            head = mutate_text(head.decode("latin-1"), rng).encode("utf-8", "replace")
        else:
            head = mutate_bytes(head, rng)
    (case / "answer").write_bytes(head + b"\r\n\r\n" + body)
    if rng.random() < 0.3:
        (case / "a.part").write_bytes(bytes(range(10)))
        (case / "a.part.json").write_text(
            mutate_text('{"version": "\\"v1\\""}', rng), errors="replace"
        )


def read_answer(place: Path, case: Path) -> None:
    """Fetch a file from a server that sends these bytes to every request."""
    download_http.N_ATTEMPTS, download_http.TIMEOUT_S = 2, 1.0
    data = (case / "answer").read_bytes()
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        threading.Thread(target=serve, args=(server, data), daemon=True).start()
        try:
            download_http.fetch(
                f"http://127.0.0.1:{server.getsockname()[1]}/a", case / "a", wait_s=0.0
            )
        except DatasetError as error:
            expect(str(error).isprintable(), "what a server says is not printable")
            raise
        finally:
            server.shutdown(socket.SHUT_RDWR)


def serve(server: socket.socket, data: bytes) -> None:
    """Send the same bytes to everybody."""
    while True:
        try:
            connection, _ = server.accept()
            with closing(connection):
                connection.recv(65536)
                connection.sendall(data)
        except OSError:
            if server.fileno() < 0 or server._closed:  # type: ignore[attr-defined]
                return


READERS = {"server": Reader(4, nothing, mutate_answer, read_answer)}
