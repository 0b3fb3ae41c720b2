"""Moved to ``slam_bof.scenes``; this name goes with the next release."""

import warnings

from slam_bof.scenes import label_map

__all__ = ["label_map"]

warnings.warn(
    "slam_bof.scene_map is now slam_bof.scenes; it goes with the next release",
    DeprecationWarning,
    stacklevel=2,
)
