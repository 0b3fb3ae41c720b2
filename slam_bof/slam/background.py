"""Mapping in a process of its own, so that the caller waits for tracking alone.

A thread would not do: GTSAM keeps Python's lock while it optimises. The process reads pickled
requests from its standard input and writes the answers to its standard output, in their order.
"""

from __future__ import annotations

import contextlib
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import traceback
import weakref
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile
from operator import attrgetter
from types import MethodType
from typing import IO, Any, NamedTuple, cast

from slam_bof.bof import compile_bof
from slam_bof.core import Checkpoint, StageClock, one_blas_thread
from slam_bof.errors import SlamBofError
from slam_bof.geometry import compile_alignment
from slam_bof.slam.config import Config
from slam_bof.slam.keyframe_map import KeyframeMap
from slam_bof.slam.mapping import KeyframeJob, MapUpdate, map_keyframe

__all__ = ["BackgroundMapping", "serve"]

MAX_WAITING = 8
"""Number of keyframes that may wait; then no frame becomes a keyframe until there is room."""
NICENESS = 5
"""Niceness of the process, so that the caller comes first where there are too few processors."""
PROTOCOL = pickle.HIGHEST_PROTOCOL
PATIENCE_S = 5.0
"""How long the process may take to end after its last request."""


@dataclass(frozen=True, slots=True)
class _Call:
    """A request for an attribute of the map or, with arguments, for the result of a method."""

    number: int
    path: str
    arguments: tuple[Any, ...] | None = None


@dataclass(frozen=True, slots=True)
class _Failure:
    """An exception in the process."""

    error: Exception


class _Unsendable:
    """Stands for an attribute that cannot be sent, and whether it is a method."""

    def __init__(self, is_method: bool) -> None:
        self.is_method = is_method


class _Answer(NamedTuple):
    """The answer to a request; ``number`` is that of the call, None for a keyframe."""

    number: int | None
    value: Any


class BackgroundMapping:
    """Hands keyframes to a process, which holds the map.

    At most ``MAX_WAITING`` keyframes wait; while they do, ``is_full`` says that no frame should
    become a keyframe. The error of a keyframe that fails is raised by ``finished``, once; that
    keyframe is not in the map, and those after it are.
    """

    def __init__(self, config: Config, clock: StageClock) -> None:
        self._unsent: list[KeyframeJob] = []
        self._last_sent: KeyframeJob | None = None
        self._n_sent = self._n_finished = self._n_calls = 0
        self._calling = threading.Lock()
        self._requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._inbox = _Inbox()
        self._updates = self._inbox.updates
        start = "from slam_bof.slam.background import serve; serve()"
        self._process = subprocess.Popen(
            [sys.executable, "-c", f"import sys; sys.path[:] = {sys.path!r}; {start}"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
        )
        for target, arguments in (
            (_send, (self._process.stdin, self._requests)),
            (_receive, (self._process.stdout, self._inbox)),
        ):
            threading.Thread(target=target, args=arguments, daemon=True).start()
        self.close = weakref.finalize(self, _end, self._process, self._requests)
        self.map = cast(KeyframeMap, _RemoteMap(self._call, ""))
        self._requests.put(config)
        len(self.map)  # waits until the process has started, or raises why it has not

    @property
    def n_waiting(self) -> int:
        """Number of keyframes that are not in the map yet."""
        return len(self._unsent) + self._n_sent - self._n_finished - len(self._updates)

    @property
    def is_full(self) -> bool:
        """Whether ``MAX_WAITING`` keyframes wait."""
        return self.n_waiting >= MAX_WAITING

    def submit(self, job: KeyframeJob) -> None:
        """Take a frame; the caller may reuse its image."""
        tracked = job.tracked
        frame = replace(tracked.frame, depth=tracked.frame.depth.copy())
        self._unsent.append(replace(job, tracked=replace(tracked, frame=frame)))

    def send(self) -> None:
        """Hand the frames to the process."""
        while self._unsent:
            if self._unsent[0] is not self._last_sent:  # unless this was interrupted below
                self._last_sent = self._unsent[0]
                self._n_sent += 1
                self._requests.put(self._last_sent)
            del self._unsent[0]

    def finished(self) -> list[MapUpdate]:
        """Return the keyframes that are in the map, oldest first, until ``forget``.

        Raises
        ------
        Exception
            What a keyframe has raised, or ``SlamBofError`` if the process has ended.
        """
        updates = list(takewhile(lambda update: not isinstance(update, _Failure), self._updates))
        if self._updates and not updates:
            failure = self._updates[0]
            self.forget(1)
            raise failure.error
        if self._inbox.is_closed and not updates:
            raise self._ended()
        return updates

    def forget(self, n: int) -> None:
        """Forget the first ``n`` of ``finished``."""
        self._n_finished += n
        del self._updates[:n]

    def drain(self) -> None:
        """Wait until no keyframe waits."""
        self.send()
        len(self.map)  # requests are answered in their order

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that restores the frames that have not been sent."""
        before = Checkpoint()
        before.save(self._unsent)
        return before.restore

    def _call(self, path: str, arguments: tuple[Any, ...] | None = None) -> Any:
        """Return an attribute of the map in the process, or the result of a method."""
        with self._calling:
            self._n_calls += 1
            self._requests.put(_Call(self._n_calls, path, arguments))
            value = self._inbox.wait_for(self._n_calls)
        if value is None:
            raise self._ended()
        if isinstance(value, _Failure):
            raise value.error
        return value[0]

    def _ended(self) -> SlamBofError:
        status = self._process.wait(PATIENCE_S)
        return SlamBofError(
            f"the process that maps in the background has ended with status {status}, expected it "
            f"to go on: {self.n_waiting} keyframes are lost, with those in its map that no journal "
            "has saved"
        )


class _Inbox:
    """Answers of the process, sorted by what they answer."""

    def __init__(self) -> None:
        self.updates: list[Any] = []
        """The result of each keyframe: a ``MapUpdate``, or a ``_Failure``."""
        self.is_closed = False
        self._calls: dict[int, Any] = {}
        self._changed = threading.Condition()

    def put(self, answer: _Answer | None) -> None:
        """Sort an answer in; None at the end."""
        with self._changed:
            if answer is None:
                self.is_closed = True
            elif answer.number is None:
                self.updates.append(answer.value)
            else:
                self._calls[answer.number] = answer.value
            self._changed.notify_all()

    def wait_for(self, number: int) -> Any:
        """Wait for the answer to a call; None if the process ends before."""
        with self._changed:
            self._changed.wait_for(lambda: number in self._calls or self.is_closed)
            value = self._calls.get(number)
            self._calls.clear()  # earlier ones are of calls that were interrupted
            return value


class _RemoteMap:
    """The map in the process: an attribute is sent, unless it cannot be; a method runs there."""

    def __init__(self, call: Callable[..., Any], path: str) -> None:
        self._call, self._path = call, path

    def __getattr__(self, name: str) -> Any:
        path = f"{self._path}{name}"
        value = self._call(path)
        if not isinstance(value, _Unsendable):
            return value
        if value.is_method:
            return lambda *arguments: self._call(path, arguments)
        return _RemoteMap(self._call, f"{path}.")

    def __len__(self) -> int:
        return int(self._call(f"{self._path}__len__", ()))

    def checkpoint(self) -> Callable[[], None]:
        """Return a function that does nothing: a call of a method there comes to its end."""
        return lambda: None


def serve() -> None:
    """Hold the map in this process, for a ``BackgroundMapping`` in the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the caller, who ends this process
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    requests, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what libraries print must not come between the answers
    map_: KeyframeMap | _Failure
    try:
        map_ = KeyframeMap(pickle.load(requests), StageClock())
        compile_alignment()
        compile_bof()
    except Exception as error:
        map_ = _Failure(error)
    with one_blas_thread():
        while True:
            try:
                request = pickle.load(requests)
            except (EOFError, pickle.UnpicklingError):
                return  # the caller has ended, perhaps within a request
            with contextlib.suppress(BrokenPipeError):
                answers.write(_answer(map_, request))
                answers.flush()


def _answer(map_: KeyframeMap | _Failure, request: KeyframeJob | _Call) -> bytes:
    """Return the pickled answer to a request."""
    number = request.number if isinstance(request, _Call) else None
    if isinstance(map_, _Failure):
        return pickle.dumps(_Answer(number, map_))
    before = Checkpoint()
    try:
        if isinstance(request, KeyframeJob):
            before.save(map_)
            return pickle.dumps(_Answer(None, map_keyframe(map_, request)), PROTOCOL)
        value = attrgetter(request.path)(map_)
        if request.arguments is not None:
            value = value(*request.arguments)
        return _dumps(number, value)
    except Exception as error:
        before.restore()
        return _fail(number, error)


def _dumps(number: int | None, value: object) -> bytes:
    """Return the pickled answer, or what stands for a value that cannot be pickled."""
    if isinstance(value, MethodType):
        return pickle.dumps(_Answer(number, (_Unsendable(is_method=True),)))
    try:
        return pickle.dumps(_Answer(number, (value,)), PROTOCOL)
    except (TypeError, AttributeError, pickle.PicklingError):
        return pickle.dumps(_Answer(number, (_Unsendable(is_method=False),)))


def _fail(number: int | None, error: Exception) -> bytes:
    """Return the pickled answer to a request that failed."""
    error.add_note("".join(traceback.format_exception(error)))
    try:
        return pickle.dumps(_Answer(number, _Failure(error)))
    except Exception:
        substitute = RuntimeError(f"{type(error).__name__}: {error}")
        return pickle.dumps(_Answer(number, _Failure(substitute)))


def _send(stream: IO[bytes], requests: queue.SimpleQueue[Any]) -> None:
    """Write requests until there is None, or until the process ends."""
    with contextlib.suppress(OSError), stream:  # that it ended is seen where answers are read
        while (request := requests.get()) is not None:
            pickle.dump(request, stream, protocol=PROTOCOL)
            stream.flush()


def _receive(stream: IO[bytes], inbox: _Inbox) -> None:
    """Read answers until the process ends."""
    with stream:
        try:
            while True:
                inbox.put(pickle.load(stream))
        except Exception:  # the end, at or within an answer
            inbox.put(None)


def _end(process: subprocess.Popen[bytes], requests: queue.SimpleQueue[Any]) -> None:
    """Let the process end, and wait for that."""
    requests.put(None)
    try:
        process.wait(PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
