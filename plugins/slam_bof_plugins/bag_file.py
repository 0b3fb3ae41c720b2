"""ROS bags as files: ROS 1, ROS 2 (SQLite) and MCAP, read through rosbags; times, random access."""

from __future__ import annotations

import itertools
import re
import struct
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection
from rosbags.typesys import Stores, get_typestore

from slam_bof.core import open_bytes, read_text
from slam_bof.errors import DatasetError

__all__ = ["BagFile", "Topic", "bag_kind", "find_bag", "open_bag"]

KINDS = {
    ".bag": ("a ROS 1 bag", b"#ROSBAG V2.0\n"),
    ".mcap": ("an MCAP file", b"\x89MCAP0\r\n"),
    ".db3": ("a ROS 2 database", b"SQLite format 3\0"),
}
METADATA = "metadata.yaml"
UNFINISHED = ".active"
"""Suffix of a ROS 1 bag that is being recorded, or whose recorder was killed."""
MAX_PART_GAP_S = 10.0
"""Largest time between two parts of one recording, or overlap of them."""


@dataclass(frozen=True, slots=True)
class Topic:
    """A topic of a bag: its name, the type of its messages, and how many there are."""

    name: str
    msgtype: str
    n_messages: int


class _BagPath(type(Path())):  # type: ignore[misc]  # Path can be subclassed from Python 3.12 on
    """A path as rosbags expects it, which chooses a reader by a suffix in small letters."""

    @property
    def suffix(self) -> str:
        return str(super().suffix).lower()


class BagFile:
    """An open bag. Messages are found by topic and number, and none is kept.

    Raises
    ------
    DatasetError
        Here and in all methods: if the file is damaged or cut off.
    """

    def __init__(self, path: Path, parts: Sequence[Path] = ()) -> None:
        self.path = path
        self._last: tuple[str, int, Iterator[tuple[Connection, int, bytes]]] | None = None
        with self._naming():
            # Older ROS 2 bags do not contain their message definitions.
            store = get_typestore(Stores.ROS2_HUMBLE)
            files = [_BagPath(part) for part in parts or [path]]
            self._reader = AnyReader(files, default_typestore=store)
            self._reader.open()
        # Data sets are never closed explicitly: the file is closed with the last reference.
        weakref.finalize(self, self._reader.close)
        with self._naming():
            self.topics = [
                Topic(name, info.msgtype or "", info.msgcount)
                for name, info in sorted(self._reader.topics.items())
            ]

    def messages(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Yield the time in ns and the message, one by one, of a topic."""
        with self._naming():
            for connection, time_ns, raw in self._reader.messages(self._connections(topic)):
                yield time_ns, self._reader.deserialize(raw, connection.msgtype)

    def spans(self) -> list[tuple[int, int]]:
        """Return the first and the last time of reception of each file, in ns."""
        with self._naming():
            return [(reader.start_time, reader.end_time) for reader in self._reader.readers]

    def first(self, topic: str) -> Any:
        """Return the first message of a topic; None if there is none."""
        return next((message for _, message in self.messages(topic)), None)

    def times(self, topic: str) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return when messages with a header were received and stamped, (N,) each, in ns.

        The file is read through, but no message is decoded or kept.
        """
        received, stamped = [], []
        with self._naming():
            for _, time_ns, raw in self._reader.messages(self._connections(topic)):
                received.append(time_ns)
                stamped.append(self._stamp_ns(raw))
            return np.array(received, np.int64), np.array(stamped, np.int64)

    def message(self, topic: str, index: int, received: NDArray[np.int64]) -> Any:
        """Return a message by its number, given when all of its topic were ``received``.

        Reading on from the last one is fast; elsewhere the bag's index is asked by time.
        """
        time_ns = int(received[index])
        with self._naming():
            messages: Iterator[tuple[Connection, int, bytes]]
            if self._last is None or self._last[:2] != (topic, index):
                messages = self._reader.messages(self._connections(topic), start=time_ns)
                for _ in range(index - int(np.searchsorted(received, time_ns))):
                    next(messages)  # received at the very same time
            else:
                messages = self._last[2]
            self._last = None
            connection, found_ns, raw = next(messages)
            if found_ns != time_ns:
                raise DatasetError(f"{self.path}: found no message {index} of {topic} at its time")
            self._last = (topic, index + 1, messages)
            return self._reader.deserialize(raw, connection.msgtype)

    def _connections(self, topic: str) -> list[Connection]:
        return [c for c in self._reader.connections if c.topic == topic]

    def _stamp_ns(self, raw: bytes) -> int:
        """Read the time of a message's header, which comes first, without decoding the rest."""
        if self._reader.is2:
            order = "<" if raw[1] & 1 else ">"
            seconds, rest = struct.unpack_from(f"{order}iI", raw, 4)
        else:
            seconds, rest = struct.unpack_from("<II", raw, 4)  # behind the sequence number
        return int(seconds) * 10**9 + int(rest)

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Turn whatever is raised on bytes that are no bag into one line that names the file."""
        try:
            yield
        except (DatasetError, GeneratorExit):
            raise
        # Damaged bytes make the library and the decoders below it raise nearly anything.
        except Exception as error:
            reason = " ".join(str(error).split())[:200] or type(error).__name__
            raise DatasetError(
                f"{self.path}: found a bag that cannot be read ({reason}), expected a whole one; "
                "rosbag reindex, ros2 bag reindex or mcap recover may repair it"
            ) from error


def bag_kind(path: Path) -> str:
    """Return the kind of bag by its first bytes, such as ``a ROS 1 bag``; empty if it is none."""
    if path.is_dir():
        try:
            text = read_text(path / METADATA)
        except (OSError, UnicodeDecodeError):
            return ""
        return "a ROS 2 bag" if "rosbag2_bagfile_information" in text else ""
    try:
        with open_bytes(path) as file:
            head = file.read(16)
    except OSError:
        return ""
    for kind, magic in KINDS.values():
        if head.startswith(magic):
            return kind
    return ""


def find_bag(path: Path) -> tuple[Path, ...]:
    """Return the bag that a path names, or the only one in the folder; empty without one.

    It has several files if the recorder split it: they differ in their numbers only, and the last
    numbers count up, as in ``walk_0.mcap``, ``walk_1.mcap``.
    """
    bags = _bags(path)
    return tuple(bags) if len(bags) == 1 or _are_parts(bags) else ()


def _bags(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path] if path.suffix.lower() in (*KINDS, UNFINISHED) else []
    if (path / METADATA).is_file() and bag_kind(path):
        return [path]
    files = [f for f in path.iterdir() if f.suffix.lower() in (*KINDS, UNFINISHED) and f.is_file()]
    return sorted(files, key=lambda file: (_numbers(file)[-1:], file.name))


def _are_parts(files: list[Path]) -> bool:
    """Return whether the files, in order, are named as the parts of one recording."""
    names = {re.sub(r"\d+", "#", file.name) for file in files}
    last = [_numbers(file)[-1] for file in files if _numbers(file)]
    return bool(files) and len(names) == 1 and last == [*range(last[0], last[0] + len(files))]


def _numbers(file: Path) -> list[int]:
    return [int(number) for number in re.findall(r"\d+", file.stem)]


def open_bag(path: Path) -> BagFile:
    """Open a bag, or the only one in a folder, which may be in several parts.

    Raises
    ------
    DatasetError
        If the file does not exist, is no bag of the kind that its name says, or is damaged; if
        parts do not follow one another in time.
    """
    parts = find_bag(path)
    if not parts:
        found = ", ".join(bag.name for bag in _bags(path)) or "no bag"
        raise DatasetError(
            f"{path}: found {found}, expected one .bag, .mcap or .db3 file, the parts of one "
            "(NAME_0, NAME_1, ...), or a folder with metadata.yaml"
        )
    for part in parts:
        _check_kind(part)
    bag = BagFile(path if len(parts) > 1 else parts[0], parts)
    for (_, end_ns), (start_ns, _) in itertools.pairwise(sorted(bag.spans())):
        gap_s = (start_ns - end_ns) * 1e-9
        if not -MAX_PART_GAP_S <= gap_s <= MAX_PART_GAP_S:
            raise DatasetError(
                f"{path}: found {len(parts)} bags that are {abs(gap_s):.0f} s apart or overlap, "
                f"expected the parts of one recording; give one of them, such as {parts[0]}"
            )
    return bag


def _check_kind(bag: Path) -> None:
    kind, suffix = bag_kind(bag), bag.suffix.lower()
    if suffix == UNFINISHED:
        raise DatasetError(
            f"{bag}: found a bag that its recorder did not close, expected a whole one; "
            f"rename it to {bag.stem} and run: rosbag reindex {bag.stem}"
        )
    for file in bag.iterdir() if bag.is_dir() else ():
        if file.is_fifo():
            raise DatasetError(f"{file}: found a named pipe, expected a file of the bag")
    expected = "a ROS 2 bag" if bag.is_dir() else KINDS[suffix][0]
    if kind != expected:
        found = kind or "something else"
        raise DatasetError(f"{bag}: found {found}, expected {expected}, as its name says")
