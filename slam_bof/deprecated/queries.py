"""Moved to ``slam_bof.store``; this name goes with the next release."""

import warnings

from slam_bof.store import query_keyframes, query_loops, query_rooms as query_regions

__all__ = ["query_keyframes", "query_loops", "query_regions"]

warnings.warn(
    "slam_bof.queries is now slam_bof.store; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
