"""Moved to ``slam_bof.datasets``; this name goes with the next release."""

import warnings

from slam_bof.datasets import FramePoseSynchroniser, SynchroniserParams

__all__ = ["FramePoseSynchroniser", "SynchroniserParams"]

warnings.warn(
    "slam_bof.live is now slam_bof.datasets; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
