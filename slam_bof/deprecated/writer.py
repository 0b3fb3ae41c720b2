"""Moved to ``slam_bof.store``; this name goes with the next release."""

import warnings

from slam_bof.store import MapWriter

__all__ = ["MapWriter"]

warnings.warn(
    "slam_bof.writer is now slam_bof.store; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
