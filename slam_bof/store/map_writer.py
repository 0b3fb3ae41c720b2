"""Writes keyframes in a thread of its own, so that the run does not wait for the disk."""

from __future__ import annotations

import os
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Self

from slam_bof.errors import MapError
from slam_bof.store.map_store import MapStore
from slam_bof.types import KeyframeRecord, OdometryState

__all__ = ["MapWriter"]


@dataclass(slots=True, eq=False)
class _Saving:
    """The newest keyframe, and whether it is saved."""

    record: KeyframeRecord
    odometry: OdometryState | None
    is_saved: bool = False


class MapWriter:
    """Commits keyframes one at a time in a thread of its own.

    A keyframe that could not be saved is tried again when the next is written, and at the end; an
    error is raised if that fails too. The store may be used by others after ``wait`` and before
    the next ``write``.

    Examples
    --------
    >>> with MapStore.create("map.db") as store, MapWriter(store) as writer:  # doctest: +SKIP
    ...     closer = LoopCloser.from_preset("indoor", journal=writer.write)
    """

    def __init__(self, store: MapStore) -> None:
        self._store = store
        self._thread = ThreadPoolExecutor(1, "map-writer")
        self._newest: _Saving | None = None
        self._last: Future[None] | None = None
        self._process_id = os.getpid()

    def write(self, record: KeyframeRecord, odometry: OdometryState | None = None) -> None:
        """Start saving a keyframe, once the keyframe before it is saved; see ``MapStore.write``.

        The same record may come again, and is saved once.

        Raises
        ------
        MapError
            If the keyframe before it could not be saved at the second try either: this one is not
            saved, and may be given again. Or if this process was forked from the one that writes.
        """
        self.wait()
        if self._newest is None or self._newest.record is not record:
            self._newest = _Saving(record, odometry)
            self._last = self._thread.submit(self._save, self._newest)

    def wait(self) -> None:
        """Wait until the last keyframe is saved; ``MapError`` if it could not be."""
        if self._is_forked():
            raise MapError(
                f"{self._store.path}: found a process that was forked from the one that writes "
                "this map; expected it to open a map of its own"
            )
        if self._last is not None:
            self._last.exception()  # waits
        if self._newest is not None and not self._newest.is_saved:
            self._last = self._thread.submit(self._save, self._newest)
            self._last.result()

    def _save(self, saving: _Saving) -> None:
        if not saving.is_saved:
            self._store.write(saving.record, saving.odometry)
            saving.is_saved = True

    def _is_forked(self) -> bool:
        """Return whether this is a fork of the process that writes, which has no such thread."""
        return os.getpid() != self._process_id

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Wait for the last keyframe, unless another error is already being raised."""
        if self._is_forked():
            return
        try:
            if error is None:
                self.wait()
        finally:
            self._thread.shutdown()
