"""Moved to ``slam_bof.store``; this name goes with the next release."""

import warnings

from slam_bof.store import replay_keyframes as read_records

__all__ = ["read_records"]

warnings.warn(
    "slam_bof.records is now slam_bof.store; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
