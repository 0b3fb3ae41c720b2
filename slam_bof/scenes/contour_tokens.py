"""BOFs of level slices as a set of tokens: shape, size, height and place of each contour.

A token is what the constellation keeps of a contour (``slam_bof.bof.Constellation``), with its
height above the floor. A view is the set of its tokens.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import N_HARMONICS, ConstellationParams, place_bofs
from slam_bof.scenes.levelled_cloud import LevelledCloud, levelled_cloud
from slam_bof.types import Array, DepthFrame

__all__ = ["N_TOKEN_VALUES", "bof_tokens", "contour_tokens", "turned_tokens"]

PARAMS = ConstellationParams()
N_TOKEN_VALUES = 6 + 2 * N_HARMONICS
"""Length of a token."""
SHAPE_WEIGHT = 3.0
"""Weight of the spectrum's magnitudes against heights in metres and logarithms of sizes."""


def bof_tokens(frame: DepthFrame, *, gravity_camera: Array | None = None) -> NDArray[np.float32]:
    """Return ``contour_tokens`` of a frame; parameters are those of ``levelled_features``."""
    return contour_tokens(levelled_cloud(frame, gravity_camera=gravity_camera))


def contour_tokens(cloud: LevelledCloud) -> NDArray[np.float32]:
    """Return a token of each contour of a view, (C, N_TOKEN_VALUES), the longest contour first.

    Its values are the height of the slice above the floor, x and z of the contour's centroid in
    the levelled frame in metres; the logarithms of largest radius and length in metres; the mean of
    the 180 radii, divided by the largest; and their spectrum.
    """
    bofs = place_bofs(cloud.points, PARAMS)
    middle_m = PARAMS.slices.top_m + PARAMS.slices.step_m * (bofs.slices + 1.0)
    columns = [
        cloud.camera_height_m - middle_m,
        bofs.centroids_m.real,
        bofs.centroids_m.imag,
        bofs.log_radii,
        np.log(bofs.lengths_m),
        bofs.means,
    ]
    return np.concatenate([np.transpose(columns), bofs.codes], axis=1, dtype=np.float32)


def turned_tokens(tokens: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return what does not change when the camera turns, of tokens (C, N_TOKEN_VALUES).

    These are height, half the distance, the logarithms of radius and length, and the magnitudes of
    the spectrum: (C, 4 + N_HARMONICS), weighted so that their distances tell contours apart.
    """
    heights_m, x_m, z_m, log_radii, log_lengths, _ = tokens[:, :6].T
    real, imaginary = np.split(tokens[:, 6:], 2, axis=1)
    columns = [heights_m, 0.5 * np.hypot(x_m, z_m), log_radii, log_lengths]
    magnitudes = SHAPE_WEIGHT * np.hypot(real, imaginary)
    return np.concatenate([np.transpose(columns), magnitudes], axis=1, dtype=np.float32)
