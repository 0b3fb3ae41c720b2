"""Contours to BOF descriptors: Boundary Of Figure, radii from the centroid (paper, section 2)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.types import Array, Contours, Params

__all__ = ["BofParams", "describe"]


class BofParams(Params):
    """How finely a contour is sampled."""

    n_points: int = Field(180, gt=2, description="n: points that a contour is quantised into")


def describe(contours: Contours, params: BofParams) -> NDArray[np.float32]:
    """Return the BOF descriptor of every contour.

    The contour, a closed polygon, is quantised into ``n_points`` points at equal arc length,
    beginning at its first point as found, and followed counter-clockwise as the image is seen
    (x right, y down). The descriptor holds the points' distances to the centroid, divided by
    the largest.

    The centroid is that of the enclosed area (by moments); a contour that encloses none (a
    line there and back, a single pixel) takes the mean of its points. The centroid may lie
    outside the contour. A contour that is a single point has descriptor zero.

    Returns
    -------
    NDArray[np.float32]
        (C, n_points) in [0, 1], the largest of each row 1.

    Examples
    --------
    >>> square = np.array([[0, 0], [0, 2], [2, 2], [2, 0]], np.int32)
    >>> contours = Contours((square,), np.zeros(1, np.int32))
    >>> describe(contours, BofParams(n_points=8))[0, :4].astype(float).round(3).tolist()
    [1.0, 0.707, 1.0, 0.707]
    """
    n = params.n_points
    if len(contours) == 0:
        return np.empty((0, n), np.float32)
    xy, starts = _concatenate_closed(contours)
    ends = np.append(starts[1:], xy.shape[1])  # one past the repeated first point
    centroids, clockwise = _moments(xy, starts)
    # Arc length along all contours one after the other, one pixel of gap between two, so that
    # one interpolation serves them all.
    step = np.hypot(*np.diff(xy))
    step[ends[:-1] - 1] = 1.0
    arc = np.concatenate([[0.0], np.cumsum(step)])
    begin = arc[starts]
    share = np.arange(n) / n
    along = begin[:, None] + share * (arc[ends - 1] - begin)[:, None]
    # Walked backwards from the same first point where the contour was found clockwise.
    along[clockwise, 1:] = along[clockwise, :0:-1]
    x = np.interp(along, arc, xy[0])
    y = np.interp(along, arc, xy[1])
    radii = np.hypot(x - centroids[0][:, None], y - centroids[1][:, None])
    largest = radii.max(axis=1, keepdims=True)
    descriptors = np.zeros((len(contours), n), np.float32)
    np.divide(radii, largest, out=descriptors, where=largest > 0, casting="same_kind")
    return descriptors


def _concatenate_closed(contours: Contours) -> tuple[Array, NDArray[np.intp]]:
    """Return all points (2, S), each contour's first repeated at its end, and the starts (C,)."""
    lengths = np.array([len(points) for points in contours.points_px])
    if lengths.min() == 0:
        raise ValueError("a contour must have at least one point, got one with none")
    closed = [part for points in contours.points_px for part in (points, points[:1])]
    xy = np.concatenate(closed).T.astype(np.float64)
    return xy, np.concatenate([[0], np.cumsum(lengths + 1)[:-1]])


def _moments(xy: Array, starts: NDArray[np.intp]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the centroids (2, C), and which contours run clockwise (C,), by Green's theorem."""
    counts = np.diff(np.append(starts, xy.shape[1]))
    # Relative to each contour's first point, which keeps small far-off areas precise.
    local = xy - np.repeat(xy[:, starts], counts, axis=1)
    x, y = local
    cross = np.zeros(len(x))
    cross[:-1] = x[:-1] * y[1:] - x[1:] * y[:-1]
    sums = local.copy()
    sums[:, :-1] += local[:, 1:]
    cross[starts[1:] - 1] = 0.0  # from the end of one contour to the start of the next
    double_area = np.add.reduceat(cross, starts)
    first_moments = np.add.reduceat(sums * cross, starts, axis=1)
    mean = np.add.reduceat(local, starts, axis=1) / np.maximum(counts - 1, 1)
    flat = double_area == 0.0
    centroids = np.where(flat, mean, first_moments / np.where(flat, 1.0, 3.0 * double_area))
    return xy[:, starts] + centroids, double_area > 0.0
