"""CPU time and wall time of code, on one thread."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import cv2
import numpy as np

from slam_bof.core import one_native_thread

__all__ = ["Cost", "one_thread"]


@dataclass
class Cost:
    """Sums of CPU and wall time in seconds, and the CPU time of each call."""

    cpu_s: float = 0.0
    wall_s: float = 0.0
    calls_s: list[float] = field(default_factory=list)

    @contextmanager
    def measure(self) -> Iterator[None]:
        """Add the cost of the ``with`` block."""
        wall_s, cpu_s = time.perf_counter(), time.process_time()
        yield
        self.calls_s.append(time.process_time() - cpu_s)
        self.cpu_s += self.calls_s[-1]
        self.wall_s += time.perf_counter() - wall_s

    @property
    def median_ms(self) -> float:
        """Median CPU time of a call, in milliseconds."""
        return 1e3 * float(np.median(self.calls_s))

    def __add__(self, other: Cost) -> Cost:
        return Cost(self.cpu_s + other.cpu_s, self.wall_s + other.wall_s)


@contextmanager
def one_thread() -> Iterator[None]:
    """Keep OpenCV, BLAS and OpenMP to one thread within the ``with`` block."""
    n_threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        with one_native_thread():
            yield
    finally:
        cv2.setNumThreads(n_threads)
