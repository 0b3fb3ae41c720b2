"""Connections to servers that may never answer, lead elsewhere, or send garbage."""

from __future__ import annotations

import contextlib
import http.client
import socket
import threading
import time
import urllib.parse
import urllib.request
from typing import Any, Self

from slam_bof.errors import DatasetError

__all__ = ["Watchdog", "open_url", "printable"]


def printable(text: object) -> str:
    r"""Return what a server has sent in one line of a moderate length.

    >>> printable("Not\r\n\x1b[31mFound")
    'Not [31mFound'
    """
    shown = "".join(c if c.isprintable() else " " for c in str(text))
    return " ".join(shown.split())[:200]


class Watchdog:
    """Context manager that cuts a connection that makes no progress.

    A time limit for each read would not: a server may send a byte now and then.

    Parameters
    ----------
    timeout_s, min_bytes
        The connection is cut if fewer bytes are counted in this time; the head of the answer
        must come within it.
    """

    def __init__(self, timeout_s: float, min_bytes: int) -> None:
        self.timeout_s = timeout_s
        self.has_cut = False
        self._min_bytes = min_bytes
        self._n_bytes = 0
        self._since_s = time.monotonic()
        self._socket: socket.socket | None = None
        self._is_done = threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def guard(self, connection: socket.socket) -> None:
        """Watch this connection from now on."""
        self._socket, self._since_s = connection, time.monotonic()

    def count(self, n_bytes: int) -> None:
        """Count bytes that have arrived."""
        self._n_bytes += n_bytes
        if self._n_bytes >= self._min_bytes:
            self._n_bytes, self._since_s = 0, time.monotonic()

    def _watch(self) -> None:
        while not self._is_done.wait(min(1.0, self.timeout_s / 4)):
            if self._socket is not None and time.monotonic() - self._since_s > self.timeout_s:
                self.has_cut = True
                with contextlib.suppress(OSError):
                    self._socket.shutdown(socket.SHUT_RDWR)
                return

    def __enter__(self) -> Self:
        """Begin to watch."""
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop watching."""
        self._is_done.set()
        self._thread.join()


def open_url(request: urllib.request.Request, watchdog: Watchdog) -> Any:
    """Open a URL as ``urllib`` does, watched, and without leaving https."""
    opener = urllib.request.build_opener(_Http(watchdog), _Https(watchdog), _StayEncrypted)
    return opener.open(request, timeout=watchdog.timeout_s)


class _Http(urllib.request.HTTPHandler):
    def __init__(self, watchdog: Watchdog) -> None:
        super().__init__()
        self._watchdog = watchdog

    def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_watched(http.client.HTTPConnection, self._watchdog), req)


class _Https(urllib.request.HTTPSHandler):
    def __init__(self, watchdog: Watchdog) -> None:
        super().__init__()
        self._watchdog = watchdog

    def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
        return self.do_open(_watched(http.client.HTTPSConnection, self._watchdog), req)


def _watched(kind: type[http.client.HTTPConnection], watchdog: Watchdog) -> Any:
    """Return a class of connections that a watchdog guards."""

    class Watched(kind):  # type: ignore[misc, valid-type]
        def connect(self) -> None:
            super().connect()
            watchdog.guard(self.sock)

    return Watched


class _StayEncrypted(urllib.request.HTTPRedirectHandler):
    """Follows redirects, but not from https to anything else."""

    def http_error_302(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any
    ) -> Any:
        try:
            return super().http_error_302(req, fp, code, msg, headers)
        except (DatasetError, ValueError):
            fp.close()
            raise

    http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302

    def redirect_request(
        self, req: urllib.request.Request, fp: Any, code: int, msg: str, headers: Any, newurl: str
    ) -> urllib.request.Request | None:
        allowed = ("https",) if req.type == "https" else ("http", "https")
        if urllib.parse.urlsplit(newurl).scheme not in allowed:
            raise DatasetError(
                f"{req.full_url}: found a redirect to {printable(newurl)}, "
                f"expected one to {' or '.join(allowed)}"
            )
        return super().redirect_request(req, fp, code, msg, headers, newurl)
