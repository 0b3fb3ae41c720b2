"""Compilation of all loops of BOF at once."""

from __future__ import annotations

from functools import cache

import numpy as np

from slam_bof.bof.bag_of_words import PlaceParams, descriptors
from slam_bof.bof.constellation import describe_constellation
from slam_bof.bof.constellation_index import ConstellationIndex
from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["compile_bof"]


@cache
def compile_bof() -> None:
    """Compile what describes and finds views, or load it from the disk, before a first frame."""
    camera = Intrinsics(64, 48, 56.0, 56.0, 31.5, 23.5)
    depth_m = np.full((camera.height, camera.width), 3.0, np.float32)
    depth_m[10:30, 20:40] = 2.0
    for depth in (depth_m, (1000 * depth_m).astype(np.uint16)):
        frame = DepthFrame(0.0, depth, camera)
        descriptors(frame, PlaceParams())
        view = describe_constellation(frame, (0.0, 1.0, 0.0)).bofs
        index = ConstellationIndex()
        index.add(view)
        index.find(view, 1)
