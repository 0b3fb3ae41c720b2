"""Binary images to closed contours (paper, section 3.2)."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from slam_bof.bof.bit_images import close, outer_contours, pack_bits
from slam_bof.bof.layers import LayerParams, draw_layers
from slam_bof.types import Array, Contours, Params

__all__ = ["ContourParams", "find_contours", "layer_contours"]


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
    return _find(pack_bits(images), images.shape[2], params, margin_px + missing)


def layer_contours(
    points: NDArray[Any],
    layers: LayerParams,
    params: ContourParams,
    *,
    gravity_camera: Array | None = None,
) -> Contours:
    """Return the contours of a cloud's layers: ``find_contours`` of ``layer_images``.

    Parameters
    ----------
    points
        (N, 3) ``points_camera``, in metres; quickest as float32 with contiguous columns.
    """
    margin_px = params.margin_px
    words = draw_layers(points, layers, gravity_camera=gravity_camera, margin_px=margin_px)
    return _find(words, layers.resolution_px + 2 * margin_px, params, margin_px)


def _find(words: NDArray[np.uint32], width: int, params: ContourParams, margin_px: int) -> Contours:
    """Close images of words (L, H, K) in place, and find their outer contours."""
    n_layers, height, n_words = words.shape
    min_area_px = params.min_area_share * (height - 2 * margin_px) * (width - 2 * margin_px)
    # All layers are processed in one tall image, where their margins separate them.
    sheet = words.reshape(n_layers * height, n_words)
    close(sheet, params.closing_px // 2)
    corners, counts = outer_contours(sheet, min_area_px)
    layer = corners[np.cumsum(counts) - counts, 1] // max(height, 1)
    corners -= np.int32(margin_px)
    corners[:, 1] -= np.repeat(layer * height, counts)
    order = np.argsort(layer, kind="stable")
    ends = np.cumsum(counts)[order]
    bounds = zip((ends - counts[order]).tolist(), ends.tolist(), strict=True)
    found = tuple(corners[start:end] for start, end in bounds)
    return Contours(found, layer[order].astype(np.int32))
