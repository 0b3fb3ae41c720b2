"""Height profile: histograms of surface areas and depth edges by height above the floor.

Tables, counters, beds and baths differ in the height, distance and size of their surfaces. Areas
are in square metres of surface, so they do not depend on the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes.levelled_cloud import LevelledCloud
from slam_bof.types import Array

__all__ = ["FLOOR_SEEN", "N_PROFILE_VALUES", "SURFACE_SHARE", "measure_profile"]

Floats = NDArray[np.float32]

HEIGHT_STEP_M, N_HEIGHTS = 0.1, 26
TILT_EDGES = (-0.9, -0.35, -0.12, 0.12, 0.35, 0.9)
"""Bin edges of the upward component of a normal: from ceilings (first) over walls to floors."""
N_TILTS = len(TILT_EDGES) + 1
LEVEL_STEP_M, N_LEVELS = 0.04, 35
"""Finer height bins, for level surfaces that face up."""
BAND_STEP_M, N_BANDS = 0.3, 9
DISTANCE_STEP_M, N_DISTANCES = 0.5, 10
MIN_CURVATURE = 0.08
"""A surface is curved where one minus the cosine between neighbouring normals exceeds this."""
EDGE_M, EDGE_SHARE = 0.06, 0.03
"""A depth edge is a step of more than this many metres plus this share of the distance."""
MIN_SLANT_COSINE = 0.15
"""Least cosine between ray and normal used for areas; grazing surfaces would seem huge."""
EXTENT_PERCENTILES = (2, 10, 50, 90, 98)

N_PROFILE_VALUES = (
    N_HEIGHTS * (N_TILTS + 1) + N_LEVELS + N_BANDS * N_DISTANCES + 2 * N_HEIGHTS + 3 * 5 + 3
)
"""Length of a profile."""
FLOOR_SEEN = N_PROFILE_VALUES - 2
"""Index of the value that says whether the floor is seen."""
SURFACE_SHARE = N_PROFILE_VALUES - 1
"""Index of the share of pixels with a surface."""


def measure_profile(cloud: LevelledCloud) -> Floats:
    """Return the height profile (N_PROFILE_VALUES,) of a levelled cloud.

    In this order: the square root of surface area by tilt and height; that of curved surfaces by
    height; that of level surfaces by finer height; that of all surfaces by horizontal distance
    and height; the square root of the length of vertical and of horizontal depth edges by height;
    percentiles of the points' x, y and z in metres; the camera's height in metres, whether the
    floor is seen (0 or 1), and the share of pixels with a surface.
    """
    points, normals = cloud.grid_points, cloud.grid_normals
    surface = normals.any(axis=-1)
    p, n = points[surface], normals[surface]
    heights_m = cloud.camera_height_m - p[:, 1]
    ranges_m = np.sqrt(np.einsum("ij,ij->i", p, p))
    slant = np.abs(np.einsum("ij,ij->i", p, n)) / np.maximum(ranges_m, 1e-6)
    areas = (ranges_m * np.float32(cloud.pixel_rad)) ** 2 / np.maximum(slant, MIN_SLANT_COSINE)
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
            _edge_lengths(cloud, points[:, 1:], points[:, :-1]),
            _edge_lengths(cloud, points[1:], points[:-1]),
        ]
    )
    known = points[..., 2] != 0.0
    extent = np.zeros((len(EXTENT_PERCENTILES), 3))
    if known.any():
        extent = np.percentile(points[known], EXTENT_PERCENTILES, axis=0)
    state = (cloud.camera_height_m, float(cloud.floor_seen), surface.mean())
    return np.concatenate([np.sqrt(squares), extent.ravel(), state]).astype(np.float32)


def _bins(values: Floats, step: float, n: int) -> NDArray[np.int32]:
    """Return the index of each value's bin, of n equal bins from 0; outliers go to the ends."""
    return np.clip((values / np.float32(step)).astype(np.int32), 0, n - 1)


def _sum(index: NDArray[np.integer], weights: Floats, n: int) -> Array:
    return np.bincount(index, weights, minlength=n).astype(np.float64)


def _curved(normals: Floats) -> NDArray[np.bool_]:
    """Return a mask (h, w) of the normals (h, w, 3) that differ from the one up and left."""
    curved = np.zeros(normals.shape[:2], bool)
    cosine = np.einsum("hwi,hwi->hw", normals[1:, 1:], normals[:-1, :-1])
    curved[1:, 1:] = cosine < 1.0 - MIN_CURVATURE
    return curved


def _edge_lengths(cloud: LevelledCloud, a: Floats, b: Floats) -> Array:
    """Return the length of depth edges between neighbours a and b (h, w, 3) by height."""
    range_a, range_b = np.linalg.norm(a, axis=-1), np.linalg.norm(b, axis=-1)
    is_step = np.abs(range_a - range_b) > EDGE_M + EDGE_SHARE * range_a
    edge = (range_a > 0) & (range_b > 0) & is_step
    row = _bins(cloud.camera_height_m - a[edge][:, 1], HEIGHT_STEP_M, N_HEIGHTS)
    return _sum(row, range_a[edge] * np.float32(cloud.pixel_rad), N_HEIGHTS)
