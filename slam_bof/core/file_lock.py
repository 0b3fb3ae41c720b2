"""A lock on an open file, on any system."""

from __future__ import annotations

import sys

__all__ = ["lock_file"]


def lock_file(descriptor: int) -> None:
    """Lock an open file for this process; an ``OSError`` if another one has locked it."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
