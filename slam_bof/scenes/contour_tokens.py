"""BOFs of level slices as a set of tokens: shape, size, height and place of each contour.

A token is what the constellation keeps of a contour (``slam_bof.bof.Constellation``), without
what changes when the camera turns. A view is the set of its tokens.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import ConstellationParams, place_bofs
from slam_bof.scenes.levelled_cloud import levelled_cloud
from slam_bof.types import Array, DepthFrame

__all__ = ["bof_tokens"]

PARAMS = ConstellationParams()
SHAPE_WEIGHT = 3.0
"""Weight of the spectrum's magnitudes against heights in metres and logarithms of sizes."""


def bof_tokens(frame: DepthFrame, *, gravity_camera: Array | None = None) -> NDArray[np.float32]:
    """Return a token of each contour of a frame, (C, D), the longest contour first.

    Its values are the height of the slice above the floor and the distance ahead in metres, half
    weighted; the logarithms of largest radius and length; and the magnitudes of the spectrum of
    the 180 radii, which do not change when the contour turns. Parameters are those of
    ``levelled_features``.
    """
    cloud = levelled_cloud(frame, gravity_camera=gravity_camera)
    bofs = place_bofs(cloud.points, PARAMS)
    middle_m = PARAMS.slices.top_m + PARAMS.slices.step_m * (bofs.slices + 1.0)
    real, imaginary = np.split(bofs.codes, 2, axis=1)
    columns = [
        cloud.camera_height_m - middle_m[:, None],
        0.5 * np.abs(bofs.centroids_m)[:, None],
        bofs.log_radii[:, None],
        np.log(bofs.lengths_m)[:, None],
        SHAPE_WEIGHT * np.hypot(real, imaginary),
    ]
    return np.concatenate(columns, axis=1).astype(np.float32)
