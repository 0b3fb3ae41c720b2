"""Measurement of wall time by stage, CPU time and memory."""

from __future__ import annotations

import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

__all__ = ["StageClock", "Usage"]


class StageClock:
    """Accumulates wall time by the name of the stage."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the ``with`` block to the stage ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - start


@dataclass(frozen=True, slots=True)
class Usage:
    """CPU and wall time in seconds: a reading of both clocks, or the difference of two readings."""

    cpu_s: float
    wall_s: float

    @classmethod
    def now(cls) -> Usage:
        """Read both clocks."""
        return cls(time.process_time(), time.perf_counter())

    def __sub__(self, earlier: Usage) -> Usage:
        """Return the time between two readings."""
        return Usage(self.cpu_s - earlier.cpu_s, self.wall_s - earlier.wall_s)


def peak_rss_mb() -> float | None:
    """Return the peak resident memory of this process so far, in MB (1e6 bytes).

    None where the system does not count it, as Windows.
    """
    try:
        import resource
    except ModuleNotFoundError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e6
