"""BOF descriptors of levelled, metric layers, with what scale they have and how high they are.

The paper's layers follow the optical axis and are stretched to what the frame shows. These are
levelled and of fixed size: slices of height, seen from above, tell the plans of table tops, beds
and sofas, and slices of distance, seen from the front, the outlines of what stands there. Each
contour's BOF is completed by its measures, which the BOF itself, scaled to 1, leaves out.
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
    find_contours,
    layer_images,
)
from slam_bof.core import scratch_image
from slam_bof.scenes.levelled_view import LevelView
from slam_bof.types import Contours

__all__ = ["N_SHAPE", "describe_shapes"]

SLICE_M, TOP_M, PLAN_PIXEL_M, FRONT_PIXEL_M = 0.2, 2.4, 0.05, 0.04

PLANS = LayerParams(
    n_layers=12,
    resolution_px=100,
    axis=(0.0, 1.0, 0.0),
    plane="axis",
    thickness_m=SLICE_M,
    start_m=-TOP_M,
    pixel_m=PLAN_PIXEL_M,
)
"""Slices of height above the floor."""
FRONTS = LayerParams(
    n_layers=10, resolution_px=125, thickness_m=0.4, start_m=0.5, pixel_m=FRONT_PIXEL_M
)
"""Slices of distance ahead."""
PLAN_AHEAD_M = 2.5
"""How far ahead of the camera a plan's middle is."""
CONTOURS = ContourParams(closing_px=5, min_area_share=0.001)
BOF = BofParams(n_points=64, start="fourier")
BOF_WEIGHT = 3.0
"""Of magnitudes against the logarithms of sizes and heights in metres."""
FRONT_APART = 5.0
"""A number that keeps fronts and plans in different words."""
MIN_SIDE_M = 0.04

N_SHAPE = BOF.n_values + 5
"""Numbers in a descriptor."""


def describe_shapes(view: LevelView) -> NDArray[np.float32]:
    """Return a descriptor of each contour, (C, N_SHAPE), C = 0 where there is none.

    The magnitudes of the BOF's spectrum; the logarithms of the smallest enclosing rectangle's
    short and long sides; the heights of the contour's bottom and top above the floor; and which
    way it was cut.
    """
    floor = np.array([0.0, view.camera_height_m, PLAN_AHEAD_M], np.float32)
    plans = _contours(view.points - floor, PLANS)
    bottoms_m = TOP_M - SLICE_M * (plans.layer + 1.0)
    above = _shapes(plans, PLAN_PIXEL_M, bottoms_m, bottoms_m + SLICE_M, 0.0)
    fronts = _contours(view.points, FRONTS)
    middle_px = FRONTS.resolution_px // 2
    rows = [(p[:, 1].min(), p[:, 1].max()) for p in fronts.points_px]
    y = (np.array(rows, np.float64).reshape(-1, 2) - middle_px) * FRONT_PIXEL_M
    tops_m, lows_m = view.camera_height_m - y[:, 0], view.camera_height_m - y[:, 1]
    ahead = _shapes(fronts, FRONT_PIXEL_M, lows_m, tops_m, FRONT_APART)
    return np.concatenate([above, ahead])


def _contours(points: NDArray[np.float32], layers: LayerParams) -> Contours:
    margin_px = CONTOURS.margin_px
    side = layers.resolution_px + 2 * margin_px
    out = scratch_image("shapes", (layers.n_layers, side, side))
    images = layer_images(points, layers, margin_px=margin_px, out=out)
    return find_contours(images, CONTOURS, margin_px=margin_px)


def _shapes(
    contours: Contours,
    pixel_m: float,
    bottoms_m: NDArray[np.floating[Any]],
    tops_m: NDArray[np.floating[Any]],
    apart: float,
) -> NDArray[np.float32]:
    sides = [sorted(cv2.minAreaRect(points)[1]) for points in contours.points_px]
    sides_m = np.array(sides, np.float64).reshape(-1, 2) * pixel_m
    logarithms = np.log(np.maximum(sides_m, MIN_SIDE_M))
    columns = [
        BOF_WEIGHT * describe(contours, BOF),
        logarithms,
        bottoms_m[:, None],
        tops_m[:, None],
        np.full((len(contours), 1), apart),
    ]
    return np.concatenate(columns, axis=1).astype(np.float32)
