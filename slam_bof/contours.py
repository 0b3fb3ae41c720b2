"""Binary images to closed contours (paper, section 3.2)."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from slam_bof.types import Contours, Params

__all__ = ["ContourParams", "find_contours"]


class ContourParams(Params):
    """What is closed first, and what is too small to count."""

    closing_px: int = Field(5, gt=0, description="side of the square closing kernel, odd; 1: none")
    min_area_share: float = Field(
        0.01, ge=0, le=1, description="smallest contour area, as a share of the image's"
    )

    @field_validator("closing_px")
    @classmethod
    def _check_odd(cls, closing_px: int) -> int:
        if closing_px % 2 == 0:
            raise ValueError(f"closing_px must be odd, got {closing_px}")
        return closing_px


def find_contours(images: NDArray[np.uint8], params: ContourParams) -> Contours:
    """Close each image and find its outer contours.

    The closing is that of the unbounded plane: the image's border neither adds nor takes
    pixels. A contour's area is that of the polygon through the centres of its pixels.

    Parameters
    ----------
    images
        (L, H, W), nonzero where a layer has points.

    Returns
    -------
    Contours
        In order of layer; (x, y) pixels of the layer's image, each 8-connected to the next.
    """
    if images.ndim != 3:
        raise ValueError(f"images must be (L, H, W), got {images.shape}")
    n_layers, height, width = images.shape
    # All layers on one canvas, far enough apart that closing cannot join them: one call each
    # to OpenCV instead of L.
    margin = params.closing_px // 2 + 1
    pitch = height + 2 * margin
    canvas = np.zeros((n_layers, pitch, width + 2 * margin), np.uint8)
    canvas[:, margin : margin + height, margin : margin + width] = images
    sheet = canvas.reshape(n_layers * pitch, width + 2 * margin)
    if params.closing_px > 1 and n_layers:
        kernel = np.ones((params.closing_px, params.closing_px), np.uint8)
        sheet = cv2.morphologyEx(sheet, cv2.MORPH_CLOSE, kernel).astype(np.uint8, copy=False)
    min_area_px = params.min_area_share * height * width
    found: list[tuple[int, NDArray[np.int32]]] = []
    for points_px in _outer_contours(sheet, min_area_px):
        layer = int(points_px[0, 1]) // pitch
        origin = np.array([margin, layer * pitch + margin], np.int32)
        found.append((layer, points_px - origin))
    found.sort(key=lambda item: item[0])
    return Contours(
        points_px=tuple(points_px for _, points_px in found),
        layer=np.array([layer for layer, _ in found], np.int32),
    )


def _outer_contours(sheet: NDArray[np.uint8], min_area_px: float) -> list[NDArray[np.int32]]:
    if sheet.size == 0:
        return []
    contours, _ = cv2.findContours(sheet, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    # Isoperimetric inequality: n steps of at most sqrt(2) enclose at most n^2 / (2 pi), so
    # that specks are dropped by their length alone.
    min_length = math.sqrt(2 * math.pi * min_area_px)
    return [
        np.asarray(contour[:, 0], np.int32)
        for contour in contours
        if len(contour) >= min_length and cv2.contourArea(contour) >= min_area_px
    ]
