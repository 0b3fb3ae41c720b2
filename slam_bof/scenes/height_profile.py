"""Height profile: histograms of surface areas and depth edges by height above the floor.

Tables, counters, beds and baths differ in the height, distance and size of their surfaces. Areas
are in square metres of surface, so they do not depend on the distance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import compiled
from slam_bof.scenes.levelled_cloud import LevelledCloud
from slam_bof.types import Array

__all__ = ["FLOOR_SEEN", "N_PROFILE_VALUES", "SURFACE_SHARE", "compile_profile", "measure_profile"]

Floats = NDArray[np.float32]

HEIGHT_STEP_M, N_HEIGHTS = np.float32(0.1), 26
TILT_EDGES = (-0.9, -0.35, -0.12, 0.12, 0.35, 0.9)
"""Bin edges of the upward component of a normal: from ceilings (first) over walls to floors."""
N_TILTS = len(TILT_EDGES) + 1
LEVEL_STEP_M, N_LEVELS = np.float32(0.04), 35
"""Finer height bins, for level surfaces that face up."""
BAND_STEP_M, N_BANDS = np.float32(0.3), 9
DISTANCE_STEP_M, N_DISTANCES = np.float32(0.5), 10
MIN_CURVATURE = 0.08
"""A surface is curved where one minus the cosine between neighbouring normals exceeds this."""
EDGE_M, EDGE_SHARE = 0.06, 0.03
"""A depth edge is a step of more than this many metres plus this share of the distance."""
MIN_SLANT_COSINE = 0.15
"""Least cosine between ray and normal used for areas; grazing surfaces would seem huge."""
EXTENT_PERCENTILES = (2, 10, 50, 90, 98)

CURVED = N_TILTS * N_HEIGHTS
LEVELS = CURVED + N_HEIGHTS
BANDS = LEVELS + N_LEVELS
EDGES = BANDS + N_DISTANCES * N_BANDS
N_SQUARES = EDGES + 2 * N_HEIGHTS
"""Where the parts of the profile begin, and the number of square roots in it."""
N_PROFILE_VALUES = N_SQUARES + 3 * len(EXTENT_PERCENTILES) + 3
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
    points = cloud.grid_points
    squares, n_surface = _measure(
        points, cloud.grid_normals, np.float32(cloud.camera_height_m), np.float32(cloud.pixel_rad)
    )
    known = points[points[..., 2] != 0.0]
    extent = np.zeros((len(EXTENT_PERCENTILES), 3))
    if len(known):
        extent = np.percentile(known, EXTENT_PERCENTILES, axis=0)
    share = n_surface / (points.shape[0] * points.shape[1])
    state = (cloud.camera_height_m, float(cloud.floor_seen), share)
    return np.concatenate([np.sqrt(squares), extent.ravel(), state]).astype(np.float32)


def compile_profile() -> None:
    """Compile what measures profiles, or load it: the first call would take a second or more."""
    nothing = np.zeros((1, 1, 3), np.float32)
    _measure(nothing, nothing, np.float32(1.0), np.float32(1.0))


@compiled
def _measure(
    points: Floats, normals: Floats, camera_height_m: np.float32, pixel_rad: np.float32
) -> tuple[Array, int]:
    """Return what the profile's square roots are taken of, and the number of pixels with a surface.

    ``points`` and ``normals`` are (h, w, 3), zero where unknown.
    """
    sums, n_surface = np.zeros(N_SQUARES), 0
    for i in range(points.shape[0]):
        for j in range(points.shape[1]):
            x, y, z = points[i, j]
            nx, ny, nz = normals[i, j]
            range_m = np.sqrt(x * x + y * y + z * z)
            height_m = camera_height_m - y
            row = min(max(int(height_m / HEIGHT_STEP_M), 0), N_HEIGHTS - 1)
            for k in range(2):  # the pixels to the left, and above
                if range_m > 0.0 and (j if k == 0 else i) > 0:
                    u, v, w = points[i - k, j - 1 + k]
                    other_m = np.sqrt(u * u + v * v + w * w)
                    is_step = abs(range_m - other_m) > EDGE_M + EDGE_SHARE * range_m
                    if other_m > 0.0 and is_step:
                        sums[EDGES + k * N_HEIGHTS + row] += range_m * pixel_rad
            if nx == 0.0 and ny == 0.0 and nz == 0.0:
                continue
            n_surface += 1
            slant = abs(x * nx + y * ny + z * nz) / max(range_m, 1e-6)
            area = (range_m * pixel_rad) ** 2 / max(slant, MIN_SLANT_COSINE)
            tilt = 0
            for edge in TILT_EDGES:
                tilt += -ny >= edge
            sums[tilt * N_HEIGHTS + row] += area
            if i > 0 and j > 0:
                u, v, w = normals[i - 1, j - 1]
                if nx * u + ny * v + nz * w < 1.0 - MIN_CURVATURE:
                    sums[CURVED + row] += area
            if tilt == N_TILTS - 1:
                sums[LEVELS + min(max(int(height_m / LEVEL_STEP_M), 0), N_LEVELS - 1)] += area
            far = min(int(np.sqrt(x * x + z * z) / DISTANCE_STEP_M), N_DISTANCES - 1)
            band = min(max(int(height_m / BAND_STEP_M), 0), N_BANDS - 1)
            sums[BANDS + far * N_BANDS + band] += area
    return sums, n_surface
