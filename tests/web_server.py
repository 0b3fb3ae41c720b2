"""A web server of our own that misbehaves as it is told to."""

from __future__ import annotations

import http.server
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field


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


@contextmanager
def serving() -> Iterator[Server]:
    state = Server()
    handler = type("H", (Handler,), {"server_state": state})
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as running:
        state.url = f"http://127.0.0.1:{running.server_address[1]}"
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield state
        running.shutdown()
        thread.join()
