"""A limit of memory, beyond which new keyframes are no longer searched for loops."""

from __future__ import annotations

import logging

from slam_bof.core import machine_memory_mb, rss_mb

__all__ = ["MemoryLimit"]

logger = logging.getLogger(__name__)

SHARE = 0.9
"""The default limit as a share of the machine's memory."""


class MemoryLimit:
    """Measures whether this process has reached its limit of memory. Once reached, it stays so."""

    def __init__(self, max_mb: float | None) -> None:
        self.max_mb = SHARE * machine_memory_mb() if max_mb is None else max_mb
        self._is_reached = False

    def is_reached(self) -> bool:
        """Return whether the limit is or was reached; the first time, log a warning."""
        if not self._is_reached and (found_mb := rss_mb() or 0.0) > self.max_mb:
            self._is_reached = True
            logger.warning(
                "found %.0f MB of memory in use, expected at most %.0f MB (map.max_memory_mb): new "
                "keyframes follow odometry, without loops, from here on",
                found_mb,
                self.max_mb,
            )
        return self._is_reached
