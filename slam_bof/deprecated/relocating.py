"""Moved to ``slam_bof.maps``; this name goes with the next release."""

import warnings

from slam_bof.maps import MapLocalizer

__all__ = ["MapLocalizer"]

warnings.warn(
    "slam_bof.relocating is now slam_bof.maps; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
