"""Writes keyframes in a thread of its own, so that the run does not wait for the disk."""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Self

from slam_bof.store.map_store import MapStore
from slam_bof.types import KeyframeRecord

__all__ = ["MapWriter"]


class MapWriter:
    """Commits keyframes one at a time in a thread of its own.

    An error in writing one keyframe is raised when the next is written, or at the end. The store
    may be used by others after ``wait`` and before the next ``write``.

    Examples
    --------
    >>> with MapStore.create("map.db") as store, MapWriter(store) as writer:  # doctest: +SKIP
    ...     closer = LoopCloser.from_preset("indoor", journal=writer.write)
    """

    def __init__(self, store: MapStore) -> None:
        self._store = store
        self._thread = ThreadPoolExecutor(1, "map-writer")
        self._last: Future[None] | None = None

    def write(self, record: KeyframeRecord) -> None:
        """Start saving a keyframe, once the keyframe before it is saved.

        Raises
        ------
        MapError
            If the keyframe before it could not be saved; this one is then not saved either.
        """
        self.wait()
        self._last = self._thread.submit(self._store.write, record)

    def wait(self) -> None:
        """Wait until the last keyframe is saved; ``MapError`` if it could not be."""
        last, self._last = self._last, None
        if last is not None:
            last.result()

    def __enter__(self) -> Self:
        """Return the writer itself."""
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        """Wait for the last keyframe, unless another error is already being raised."""
        try:
            if error is None:
                self.wait()
        finally:
            self._thread.shutdown()
