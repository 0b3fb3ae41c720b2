"""Compilation of all loops of tracking and alignment at once."""

from __future__ import annotations

from functools import cache

import numpy as np

from slam_bof.core import find_kept
from slam_bof.geometry.depth_view import make_view
from slam_bof.geometry.observability import open_directions
from slam_bof.geometry.point_to_plane import refine
from slam_bof.geometry.projective_icp import AlignmentParams, ViewAligner
from slam_bof.geometry.weak_direction_search import search_weak_directions
from slam_bof.types import DepthFrame, Intrinsics

__all__ = ["compile_alignment"]


@cache
def compile_alignment() -> str:
    """Compile alignment, or load it from the disk, before a first frame would wait for it.

    Returns the folder in which the code is kept; empty if every process compiles it again.
    """
    aligner = ViewAligner(AlignmentParams())
    camera = Intrinsics(32, 24, 28.0, 28.0, 15.5, 11.5)
    wall = DepthFrame(0.0, np.full((camera.height, camera.width), 2.0, np.float32), camera)
    for _ in range(2):
        aligner.add(make_view(wall))
    matches, T = np.array([0]), np.eye(4)[None]
    aligner.rough_score(1, matches, T, np.zeros(1))
    aligner.align(1, matches, T[None])
    aligner.agreement(1, matches, T)
    aligner.coverage(1, matches, T)
    open_directions(aligner, 1, 0, T[0])
    search_weak_directions(aligner, 1, 0, T[0], T, seed=0)
    return find_kept(refine)
