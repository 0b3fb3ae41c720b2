"""What stands how high: surfaces and edges of a levelled view by height above the floor.

Tables, counters, beds and baths differ by how high, how far and how large their surfaces lie.
Areas are of the surfaces themselves, in square metres, so that they do not depend on the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes.levelled_view import LevelView
from slam_bof.types import Array

__all__ = ["N_PROFILE", "measure_profile"]

Floats = NDArray[np.float32]

HEIGHT_STEP_M, N_HEIGHTS = 0.1, 26
TILT_EDGES = (-0.9, -0.35, -0.12, 0.12, 0.35, 0.9)
"""Of a surface normal's upward part: from ceilings (first) over walls to floors (last)."""
N_TILTS = len(TILT_EDGES) + 1
LEVEL_STEP_M, N_LEVELS = 0.04, 35
"""Finer heights, for surfaces that lie level and face up."""
BAND_STEP_M, N_BANDS = 0.3, 9
DISTANCE_STEP_M, N_DISTANCES = 0.5, 10
CURVED = 0.08
"""One minus the cosine between the normals of neighbours, from which a surface is curved."""
EDGE_M, EDGE_SHARE = 0.06, 0.03
"""A step in distance of more than this, plus such a share of it, is an edge."""
MIN_SLANT = 0.15
"""Of a surface seen at a lesser cosine, the area is not believed."""
EXTENT_PERCENTILES = (2, 10, 50, 90, 98)

N_PROFILE = N_HEIGHTS * (N_TILTS + 1) + N_LEVELS + N_BANDS * N_DISTANCES + 2 * N_HEIGHTS + 3 * 5 + 3
"""Numbers in a profile."""


def measure_profile(view: LevelView) -> Floats:
    """Return the profile (N_PROFILE,) of a view, all in metres or their square root of squares.

    In turn: the square root of surface area by tilt and height; that of curved surfaces by
    height; of level ones by finer height; of all by distance in plan and height; the square root
    of the length of depth edges, upright and lying, by height; percentiles of the points' x, y, z;
    the camera's height, whether that is known, and the share of pixels with a surface.
    """
    points, normals = view.grid_points, view.grid_normals
    surface = normals.any(axis=-1)
    p, n = points[surface], normals[surface]
    heights_m = view.camera_height_m - p[:, 1]
    ranges_m = np.sqrt(np.einsum("ij,ij->i", p, p))
    slant = np.abs(np.einsum("ij,ij->i", p, n)) / np.maximum(ranges_m, 1e-6)
    areas = (ranges_m * np.float32(view.pixel_rad)) ** 2 / np.maximum(slant, MIN_SLANT)
    row = _bins(heights_m, HEIGHT_STEP_M, N_HEIGHTS)
    tilt = np.digitize(-n[:, 1], TILT_EDGES)
    curved = _curved(normals)[surface]
    level = tilt == N_TILTS - 1
    band = _bins(heights_m, BAND_STEP_M, N_BANDS)
    distance = _bins(np.hypot(p[:, 0], p[:, 2]), DISTANCE_STEP_M, N_DISTANCES)
    squares = np.concatenate(
        [
            _sum(tilt * N_HEIGHTS + row, areas, N_TILTS * N_HEIGHTS),
            _sum(row[curved], areas[curved], N_HEIGHTS),
            _sum(_bins(heights_m[level], LEVEL_STEP_M, N_LEVELS), areas[level], N_LEVELS),
            _sum(distance * N_BANDS + band, areas, N_DISTANCES * N_BANDS),
            _edge_lengths(view, points[:, 1:], points[:, :-1]),
            _edge_lengths(view, points[1:], points[:-1]),
        ]
    )
    known = points[..., 2] != 0.0
    extent = np.zeros((len(EXTENT_PERCENTILES), 3))
    if known.any():
        extent = np.percentile(points[known], EXTENT_PERCENTILES, axis=0)
    state = (view.camera_height_m, float(view.floor_seen), surface.mean())
    return np.concatenate([np.sqrt(squares), extent.ravel(), state]).astype(np.float32)


def _bins(values: Floats, step: float, n: int) -> NDArray[np.int32]:
    """Return which of n equal steps from 0 each value is in; what lies outside is in the ends."""
    return np.clip((values / np.float32(step)).astype(np.int32), 0, n - 1)


def _sum(index: NDArray[np.integer], weights: Floats, n: int) -> Array:
    return np.bincount(index, weights, minlength=n).astype(np.float64)


def _curved(normals: Floats) -> NDArray[np.bool_]:
    """Tell of each pixel of a grid of normals (h, w, 3) whether the one up and left differs."""
    curved = np.zeros(normals.shape[:2], bool)
    cosine = np.einsum("hwi,hwi->hw", normals[1:, 1:], normals[:-1, :-1])
    curved[1:, 1:] = cosine < 1.0 - CURVED
    return curved


def _edge_lengths(view: LevelView, a: Floats, b: Floats) -> Array:
    """Return by height the length of edges between neighbours a and b (h, w, 3) of the grid."""
    far_a, far_b = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1)
    edge = (far_a > 0) & (far_b > 0) & (np.abs(far_a - far_b) > EDGE_M + EDGE_SHARE * far_a)
    row = _bins(view.camera_height_m - a[edge][:, 1], HEIGHT_STEP_M, N_HEIGHTS)
    return _sum(row, far_a[edge] * np.float32(view.pixel_rad), N_HEIGHTS)
