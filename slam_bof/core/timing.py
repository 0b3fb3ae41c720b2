"""Where the time goes: wall seconds by stage."""

from __future__ import annotations

import resource
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

__all__ = ["StageClock", "Usage"]


class StageClock:
    """Adds up wall time by stage name."""

    def __init__(self) -> None:
        self.seconds: defaultdict[str, float] = defaultdict(float)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Count the time of the ``with`` block towards ``name``."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] += time.perf_counter() - start


@dataclass(frozen=True, slots=True)
class Usage:
    """Processor and wall seconds, from a first call to ``now`` to a second one."""

    cpu_s: float
    wall_s: float

    @classmethod
    def now(cls) -> Usage:
        """Read both clocks."""
        return cls(time.process_time(), time.perf_counter())

    def __sub__(self, earlier: Usage) -> Usage:
        """Return what passed between two readings."""
        return Usage(self.cpu_s - earlier.cpu_s, self.wall_s - earlier.wall_s)


def peak_rss_mb() -> float:
    """Return the most memory that this process has held so far, in MB (1e6 bytes)."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak * (1 if sys.platform == "darwin" else 1024) / 1e6
