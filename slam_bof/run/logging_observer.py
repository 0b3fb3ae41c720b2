"""An observer of a run that writes the log."""

from __future__ import annotations

import logging
import re
from pathlib import Path

from slam_bof.ports import Observer
from slam_bof.run.health import HealthLog
from slam_bof.types import Step

__all__ = ["LoggingObserver", "read_warnings"]

logger = logging.getLogger(__name__)

OF_FRAMES = re.compile(r"frame \d+: odometry (lost|recovered)")


class LoggingObserver:
    """Logs warnings and where odometry is lost and recovered, and informs another observer."""

    def __init__(self, observer: Observer, first: int) -> None:
        self.health = HealthLog()
        self._first = first
        self._observer = observer
        self._is_lost = False

    @property
    def n_frames(self) -> int:
        """Number of frames so far."""
        return len(self.health.frames)

    def on_start(self, n_frames: int) -> None:
        """Inform the other observer."""
        self._observer.on_start(n_frames)

    def on_step(self, frame_index: int, step: Step) -> None:
        """Log where odometry is lost and recovered, and inform the other observer."""
        self.health.add(step)
        if step.is_lost != self._is_lost:
            self._is_lost = step.is_lost
            logger.warning(
                "frame %d: odometry %s",
                self._first + frame_index,
                "lost" if step.is_lost else "recovered",
            )
        self._observer.on_step(frame_index, step)

    def on_warning(self, message: str) -> None:
        """Log the warning and inform the other observer."""
        logger.warning(message)
        self._observer.on_warning(message)


def read_warnings(log: Path) -> list[str]:
    """Return the warnings of a run from its log, each once, but for where odometry was lost.

    There are none if there is no such file.
    """
    if not log.is_file():
        return []
    mark = f" WARNING {logger.name}: "
    lines = log.read_text(encoding="utf-8", errors="replace").splitlines()
    found = dict.fromkeys(line.split(mark, 1)[1] for line in lines if mark in line)
    return [warning for warning in found if not OF_FRAMES.fullmatch(warning)]
