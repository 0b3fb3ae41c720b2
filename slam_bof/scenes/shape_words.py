"""BOF descriptors of the contours of levelled, metric layers, with their sizes and heights.

The paper's layers follow the optical axis and are stretched to the extent of the cloud. These are
levelled and of fixed size: slices of height, seen from above, show the outlines of table tops,
beds and sofas; slices of distance, seen from the front, show those of upright furniture. A BOF is
scaled to 1, so each descriptor also holds the contour's size and height in metres.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import (
    BofParams,
    ContourParams,
    LayerParams,
    describe,
    layer_contours,
)
from slam_bof.scenes.levelled_cloud import LevelledCloud
from slam_bof.types import Contours

__all__ = ["N_SHAPE_VALUES", "shape_descriptors"]

SLICE_M, TOP_M, PLAN_PIXEL_M, FRONT_PIXEL_M = 0.2, 2.4, 0.05, 0.04

HEIGHT_SLICES = LayerParams(
    n_layers=12,
    resolution_px=100,
    axis=(0.0, 1.0, 0.0),
    plane="axis",
    thickness_m=SLICE_M,
    start_m=-TOP_M,
    pixel_m=PLAN_PIXEL_M,
)
"""Horizontal slices, by height above the floor."""
DISTANCE_SLICES = LayerParams(
    n_layers=10, resolution_px=125, thickness_m=0.4, start_m=0.5, pixel_m=FRONT_PIXEL_M
)
"""Vertical slices, by distance ahead of the camera."""
PLAN_CENTER_M = 2.5
"""Distance ahead of the camera at which the image of a horizontal slice is centred."""
CONTOURS = ContourParams(closing_px=5, min_area_share=0.001)
BOF = BofParams(n_points=64, start="fourier")
BOF_WEIGHT = 3.0
"""Weight of the BOF's magnitudes against the logarithms of sizes and the heights in metres."""
DISTANCE_SLICE_OFFSET = 5.0
"""Last value of descriptors of distance slices (0 for height slices): keeps their words apart."""
MIN_SIDE_M = 0.04

N_SHAPE_VALUES = BOF.n_values + 5
"""Length of a descriptor."""


def shape_descriptors(cloud: LevelledCloud) -> NDArray[np.float32]:
    """Return a descriptor of each contour, (C, N_SHAPE_VALUES), C = 0 where there is none.

    It holds the magnitudes of the BOF's spectrum; the logarithms of the short and long side of the
    smallest enclosing rectangle; the heights of the contour's bottom and top above the floor in
    metres; and a value that differs between height and distance slices.
    """
    plan_origin = np.array([0.0, cloud.camera_height_m, PLAN_CENTER_M], np.float32)
    plans = layer_contours(cloud.points - plan_origin, HEIGHT_SLICES, CONTOURS)
    bottoms_m = TOP_M - SLICE_M * (plans.layer + 1.0)
    above = _describe(plans, PLAN_PIXEL_M, bottoms_m, bottoms_m + SLICE_M, 0.0)
    fronts = layer_contours(cloud.points, DISTANCE_SLICES, CONTOURS)
    middle_px = DISTANCE_SLICES.resolution_px // 2
    rows = [(p[:, 1].min(), p[:, 1].max()) for p in fronts.points_px]
    y = (np.array(rows, np.float64).reshape(-1, 2) - middle_px) * FRONT_PIXEL_M
    tops_m, bottoms_m = cloud.camera_height_m - y[:, 0], cloud.camera_height_m - y[:, 1]
    ahead = _describe(fronts, FRONT_PIXEL_M, bottoms_m, tops_m, DISTANCE_SLICE_OFFSET)
    return np.concatenate([above, ahead])


def _describe(
    contours: Contours,
    pixel_m: float,
    bottoms_m: NDArray[np.floating[Any]],
    tops_m: NDArray[np.floating[Any]],
    offset: float,
) -> NDArray[np.float32]:
    sides = [sorted(cv2.minAreaRect(points)[1]) for points in contours.points_px]
    sides_m = np.array(sides, np.float64).reshape(-1, 2) * pixel_m
    columns = [
        BOF_WEIGHT * describe(contours, BOF),
        np.log(np.maximum(sides_m, MIN_SIDE_M)),
        bottoms_m[:, None],
        tops_m[:, None],
        np.full((len(contours), 1), offset),
    ]
    return np.concatenate(columns, axis=1).astype(np.float32)
