"""Binary images to closed contours (paper, section 3.2)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from slam_bof.types import Contours, Params

__all__ = ["ContourParams", "find_contours"]


class ContourParams(Params):
    """Morphological closing of an image, and the least area of its contours."""

    closing_px: int = Field(
        5,
        gt=0,
        description="Side of the square kernel of the morphological closing, an odd number of "
        "pixels; 1 closes nothing.",
    )
    min_area_share: float = Field(
        0.01, ge=0, le=1, description="Least area of a contour, as a share of the image's area."
    )

    @field_validator("closing_px")
    @classmethod
    def _check_odd(cls, closing_px: int) -> int:
        if closing_px % 2 == 0:
            raise ValueError(f"closing_px must be odd, got {closing_px}")
        return closing_px

    @property
    def margin_px(self) -> int:
        """Number of empty pixels around an image that the closing needs."""
        return self.closing_px // 2 + 1


def find_contours(
    images: NDArray[np.uint8], params: ContourParams, *, margin_px: int = 0
) -> Contours:
    """Close each image and find its outer contours.

    The closing is that of an unbounded plane: the image's border neither adds nor removes pixels.
    A contour's area is that of the polygon through the centres of its pixels.

    Parameters
    ----------
    images
        (L, H + 2 margin, W + 2 margin), nonzero where a layer has points.
    margin_px
        Number of empty pixels around each image. If it is less than ``params.margin_px``, a copy
        with the missing pixels is made.

    Returns
    -------
    Contours
        In order of layer; corners (x, y) in pixels of the layer's image without margin.
    """
    if images.ndim != 3:
        raise ValueError(f"images must be (L, H, W), got {images.shape}")
    missing = max(params.margin_px - margin_px, 0)
    if missing:
        images = np.pad(images, ((0, 0), (missing, missing), (missing, missing)))
        margin_px += missing
    n_layers, height, width = images.shape
    if images.size == 0:
        return Contours(points_px=(), layer=np.empty(0, np.int32))
    min_area_px = params.min_area_share * (height - 2 * margin_px) * (width - 2 * margin_px)
    # All layers are processed in one tall image, where their margins separate them.
    sheet = images.reshape(n_layers * height, width)
    kernel = np.ones((params.closing_px, params.closing_px), np.uint8)
    closed = cv2.morphologyEx(sheet, cv2.MORPH_CLOSE, kernel)
    # The corners define the same polygon as all pixels, with a quarter of the points.
    found, _ = cv2.findContours(closed, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    kept = [contour for contour in found if cv2.contourArea(contour) >= min_area_px]
    layer = np.array([contour[0, 0, 1] // height for contour in kept], np.int32)
    origins = np.stack([np.zeros_like(layer), layer * height], axis=1) + np.int32(margin_px)
    order = np.argsort(layer, kind="stable")
    return Contours(
        points_px=tuple(kept[i][:, 0] - origins[i] for i in order.tolist()), layer=layer[order]
    )
