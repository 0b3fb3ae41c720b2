"""Level slices of what a camera sees, and their contours in plan.

They are the layers of the paper (section 3.2), but level, of a fixed height and in metres, so that
an object looks the same whatever else the frame shows and wherever the camera stands. Slices
overlap by half, so that a surface at the border of one is well inside the next.
"""

from __future__ import annotations

from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from slam_bof.bof.bit_images import close, dilate, is_set, n_words, outer_contours, set_bit
from slam_bof.core import compiled
from slam_bof.types import Params

__all__ = ["DEFAULT_SLICES", "SliceContours", "SliceParams", "draw_slices", "find_slice_contours"]


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


DEFAULT_SLICES = SliceParams()


class SliceContours(NamedTuple):
    """Closed contours in plan, one after the other.

    ``corners_m`` (S,) complex128 are the corners ``x + i z`` of closed polygons, metres in the
    levelled frame (x right, z ahead). Contour i has ``counts[i]`` of them and was found in slice
    ``slices[i]``; both are (C,) int.
    """

    corners_m: NDArray[np.complex128]
    counts: NDArray[np.intp]
    slices: NDArray[np.intp]


def find_slice_contours(points_level: NDArray[np.float32], params: SliceParams) -> SliceContours:
    """Return the outer contours, of any size, of all slices after closing and dilation.

    Parameters
    ----------
    points_level
        (N, 3) in the levelled frame (x right, y down, z ahead), metres.
    """
    p, margin = params, params.margin_px
    words = draw_slices(points_level, params)
    n_slices, height, width = words.shape
    # All slices in one tall sheet: their margins keep them apart, and one call serves all.
    sheet = words.reshape(n_slices * height, width)
    close(sheet, p.closing_px // 2)
    dilate(sheet, p.dilation_px // 2)
    corners, counts = outer_contours(sheet, 0.0)
    slices = corners[np.cumsum(counts) - counts, 1] // height
    middle = p.side_px // 2 - 0.5 + margin
    column = corners[:, 0] - middle
    row = corners[:, 1] - np.repeat(slices, counts) * height - middle
    corners_m = column * p.pixel_m + 1j * (row * p.pixel_m + p.ahead_m)
    return SliceContours(corners_m, counts, slices.astype(np.intp))


def draw_slices(points_level: NDArray[np.float32], params: SliceParams) -> NDArray[np.uint32]:
    """Draw points (N, 3) in their slices, where a pixel holds at least two of a slice's points.

    Returns
    -------
    NDArray[np.uint32]
        (n_slices, H, K) words of bits (``bit_images``), rows along z, columns along x, with
        ``params.margin_px`` empty pixels around the square.
    """
    p = params
    height = p.side_px + 2 * p.margin_px
    once = np.zeros((p.n_slices + 1, height, n_words(height)), np.uint32)
    twice = np.zeros_like(once)
    corner = np.array([0.0, p.top_m, p.ahead_m], np.float32)
    steps = np.array([1 / p.pixel_m, 1 / p.step_m, 1 / p.pixel_m], np.float32)
    points = np.ascontiguousarray(points_level)
    _draw_slabs(points, corner, steps, p.side_px, p.margin_px, once, twice)
    # A slab is half a slice. Two points in one, or one in each, are two in the slice.
    return (once[:-1] & once[1:]) | twice[:-1] | twice[1:]


@compiled
def _draw_slabs(
    points: NDArray[np.float32],
    corner: NDArray[np.float32],
    steps: NDArray[np.float32],
    side: int,
    margin: int,
    once: NDArray[np.uint32],
    twice: NDArray[np.uint32],
) -> None:
    """Set the pixels of each slab that hold a point, and those that hold more than one."""
    n_slabs, height, width = once.shape
    once_rows, twice_rows = once.reshape(-1, width), twice.reshape(-1, width)
    for i in range(len(points)):
        column = np.floor((points[i, 0] - corner[0]) * steps[0]) + side // 2
        slab = np.floor((points[i, 1] - corner[1]) * steps[1])
        row = np.floor((points[i, 2] - corner[2]) * steps[2]) + side // 2
        if 0 <= slab < n_slabs and 0 <= row < side and 0 <= column < side:
            at = int(slab) * height + int(row) + margin, int(column) + margin
            if is_set(once_rows, *at):
                set_bit(twice_rows, *at)
            else:
                set_bit(once_rows, *at)
