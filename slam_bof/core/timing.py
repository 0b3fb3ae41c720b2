"""Measurement of wall time by stage, CPU time and memory."""

from __future__ import annotations

import os
import sys
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

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


def rss_mb() -> float | None:
    """Return the resident memory of this process, in MB; elsewhere than on Linux, its peak."""
    try:
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    except (OSError, IndexError, ValueError):
        return peak_rss_mb()
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def machine_memory_mb() -> float:
    """Return how much memory the machine has, or its container, in MB; infinity if not known."""
    sizes = [float("inf")]
    with suppress(AttributeError, OSError, ValueError):  # Windows has no sysconf
        sizes.append(float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")))
    with suppress(OSError, ValueError):  # "max" if there is no limit
        sizes.append(float(Path("/sys/fs/cgroup/memory.max").read_text(encoding="ascii")))
    return min(size for size in sizes if size > 0) / 1e6


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
