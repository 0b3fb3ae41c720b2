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
    _, height, width = images.shape
    min_area_px = params.min_area_share * height * width
    # Isoperimetric inequality: n steps of at most sqrt(2) enclose at most n^2 / (2 pi), so
    # that specks are dropped by their length alone.
    min_length = math.sqrt(2 * math.pi * min_area_px)
    margin = params.closing_px // 2 + 1
    sheet = np.zeros((height + 2 * margin, width + 2 * margin), np.uint8)
    inside = sheet[margin : margin + height, margin : margin + width]
    kernel = np.ones((params.closing_px, params.closing_px), np.uint8)
    points_px: list[NDArray[np.int32]] = []
    layers: list[int] = []
    for layer, image in enumerate(images):
        inside[...] = image
        closed = cv2.morphologyEx(sheet, cv2.MORPH_CLOSE, kernel)
        found, _ = cv2.findContours(
            closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE, offset=(-margin, -margin)
        )
        for contour in found:
            if len(contour) >= min_length and cv2.contourArea(contour) >= min_area_px:
                points_px.append(np.asarray(contour[:, 0], np.int32))
                layers.append(layer)
    return Contours(points_px=tuple(points_px), layer=np.array(layers, np.int32))
