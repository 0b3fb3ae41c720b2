"""Level slices of what a camera sees, and their contours in plan.

Layers as the paper has them (section 3.2), but level, of a fixed height and in metres, so that
a thing looks the same whatever else the frame shows and wherever the camera stands. Slices
overlap by half: what is cut badly by one is cut well by the next.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from slam_bof.types import Params

__all__ = ["SliceContours", "SliceParams", "find_slice_contours", "slice_images"]


class SliceParams(Params):
    """Where slices are, and how their contours are drawn. Lengths in metres."""

    n_slices: int = Field(
        30,
        gt=0,
        le=127,
        description="Number of horizontal slices, each above the one before.",
    )
    step_m: float = Field(
        0.1,
        gt=0,
        description="Height from one slice to the next, in m; each is two steps thick.",
    )
    top_m: float = Field(
        -1.4,
        description="Height at which the first slice begins, in m below the camera.",
    )
    pixel_m: float = Field(0.04, gt=0, description="Edge length of a pixel, in m.")
    side_m: float = Field(
        9.0,
        gt=0,
        description="Edge length of the square of floor that a slice shows, in m.",
    )
    ahead_m: float = Field(
        2.5,
        description="Distance of the middle of that square ahead of the camera, in m.",
    )
    closing_px: int = Field(
        5,
        gt=0,
        description="Edge length of the closing kernel, in pixels; odd.",
    )
    dilation_px: int = Field(
        3,
        gt=0,
        description="Edge length of the dilation kernel, in pixels; odd.",
    )

    @model_validator(mode="after")
    def _check_odd(self) -> Self:
        for name in ("closing_px", "dilation_px"):
            if getattr(self, name) % 2 == 0:
                raise ValueError(f"{name} must be odd, got {getattr(self, name)}")
        return self

    @property
    def side_px(self) -> int:
        """Pixels along a side of the square."""
        return round(self.side_m / self.pixel_m)

    @property
    def margin_px(self) -> int:
        """Empty pixels around an image in which closing and dilation have room."""
        return self.closing_px // 2 + self.dilation_px // 2 + 1


class SliceContours(NamedTuple):
    """Closed contours in plan, one after the other.

    ``corners_m`` (S,) complex128 are the corners ``x + i z`` of closed polygons, metres in the
    levelled frame (x right, z ahead). Contour i has ``counts[i]`` of them and was found in slice
    ``slices[i]``; both are (C,) int.
    """

    corners_m: NDArray[np.complex128]
    counts: NDArray[np.intp]
    slices: NDArray[np.intp]


def slice_images(
    points_level: NDArray[np.float32], params: SliceParams
) -> tuple[NDArray[np.uint8], tuple[int, int, int]]:
    """Draw points in their slices, 1 where a pixel holds at least two of a slice's points.

    Parameters
    ----------
    points_level
        (N, 3) in the levelled frame (x right, y down, z ahead), metres.

    Returns
    -------
    images : (K, H, W) uint8
        Rows along z, columns along x: as many slices and as much of the square as have points,
        with ``params.margin_px`` empty pixels around these.
    origin : (int, int, int)
        Slice, and row and column of the square, of the first pixel.
    """
    p, side, margin = params, params.side_px, params.margin_px
    x, y, z = points_level.T
    column = np.floor(x * np.float32(1 / p.pixel_m)).astype(np.int32) + side // 2
    row = np.floor((z - np.float32(p.ahead_m)) * np.float32(1 / p.pixel_m)).astype(np.int32)
    row += side // 2
    slab = np.floor((y - np.float32(p.top_m)) * np.float32(1 / p.step_m)).astype(np.int32)
    inside = (column >= 0) & (column < side) & (row >= 0) & (row < side)
    inside &= (slab >= 0) & (slab <= p.n_slices)
    column, row, slab = column[inside], row[inside], slab[inside]
    if len(slab) == 0:
        return np.zeros((0, 0, 0), np.uint8), (0, 0, 0)
    first, last = max(int(slab.min()) - 1, 0), min(int(slab.max()), p.n_slices - 1)
    origin = first, int(row.min()) - margin, int(column.min()) - margin
    shape = int(row.max()) - origin[1] + 1 + margin, int(column.max()) - origin[2] + 1 + margin
    # A slab is half a slice. Two points in one, or one in each, are two in the slice.
    cells = ((slab - first) * shape[0] + row - origin[1]) * shape[1] + column - origin[2]
    cells.sort()
    once = np.zeros((last - first + 2, *shape), np.uint8)
    twice = np.zeros_like(once)
    once.reshape(-1)[cells] = 1
    twice.reshape(-1)[cells[1:][cells[1:] == cells[:-1]]] = 1
    images = once[:-1] & once[1:]
    images |= twice[:-1]
    images |= twice[1:]
    return images, origin


def find_slice_contours(points_level: NDArray[np.float32], params: SliceParams) -> SliceContours:
    """Return the outer contours of all slices, after closing and dilation, any size.

    Parameters
    ----------
    points_level
        (N, 3) in the levelled frame (x right, y down, z ahead), metres.
    """
    images, origin = slice_images(points_level, params)
    n_slices, height, width = images.shape
    # All slices in one tall sheet: their margins keep them apart, and one call serves all.
    sheet = images.reshape(n_slices * height, width)
    if sheet.size:
        drawn = np.empty_like(sheet)
        cv2.morphologyEx(sheet, cv2.MORPH_CLOSE, _square(params.closing_px), dst=drawn)
        cv2.dilate(drawn, _square(params.dilation_px), dst=sheet)
    found, _ = cv2.findContours(sheet, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    counts = np.array([len(contour) for contour in found], np.intp)
    corners = np.concatenate([np.empty((0, 1, 2), np.int32), *found])[:, 0]
    slices = corners[np.cumsum(counts) - counts, 1] // max(height, 1)
    middle = params.side_px // 2 - 0.5
    column = corners[:, 0] + (origin[2] - middle)
    row = corners[:, 1] - np.repeat(slices, counts) * height + (origin[1] - middle)
    corners_m = column * params.pixel_m + 1j * (row * params.pixel_m + params.ahead_m)
    return SliceContours(corners_m, counts, slices.astype(np.intp) + origin[0])


def _square(side_px: int) -> NDArray[np.uint8]:
    return np.ones((side_px, side_px), np.uint8)
