"""Contours to BOF descriptors: Boundary Object Function, radii from the centroid (section 2)."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.types import Array, Contours, Params

__all__ = ["BofParams", "describe"]

Complex = NDArray[np.complex128]

POINT_PX = 1e-6
"""A contour whose largest radius is below this is a point; its radii are rounding errors."""


class BofParams(Params):
    """Sampling of a contour, and first value of its descriptor.

    The paper specifies neither. Beyond it, ``farthest`` begins at the largest radius, and
    ``fourier`` keeps only the magnitudes of the radii's spectrum; both are invariant to rotations
    of the shape in the image.
    """

    n_points: int = Field(
        180, gt=2, description="Number of points that a contour is sampled at (the paper's n)."
    )
    sampling: Literal["arc", "angle"] = Field(
        "arc",
        description="Sampling at equal steps along the contour (arc), or at equal angles as seen "
        "from its centroid (angle).",
    )
    start: Literal["found", "farthest", "fourier"] = Field(
        "found",
        description="First value of a descriptor: the first point as found, the farthest point, "
        "or magnitudes of the Fourier spectrum instead of radii, which do not depend "
        "on the first point.",
    )

    @property
    def n_values(self) -> int:
        """Length of a descriptor."""
        return self.n_points // 2 + 1 if self.start == "fourier" else self.n_points


def describe(contours: Contours, params: BofParams) -> NDArray[np.float32]:
    """Return the BOF descriptor of every contour.

    The contour, a closed polygon, is quantised into ``n_points`` points at equal arc length,
    beginning at its first point as found, and followed counter-clockwise as the image is seen
    (x right, y down). The descriptor holds the points' distances to the centroid, divided by
    the largest. Sampled by angle, the k-th point is the farthest one on the ray that leaves the
    centroid at 2 pi k / n, counter-clockwise from the right, 0 where there is none.

    The centroid is that of the enclosed area (by moments); a contour that encloses none (a
    line there and back, a single pixel) takes that of the line it draws. The centroid may lie
    outside the contour. A contour that is a single point has descriptor zero.

    Returns
    -------
    NDArray[np.float32]
        (C, n_values) in [0, 1]. Radii: the largest of each row is 1. Fourier magnitudes:
        ``|F_k| / n`` of those radii.

    Examples
    --------
    >>> square = np.array([[0, 0], [0, 2], [2, 2], [2, 0]], np.int32)
    >>> contours = Contours((square,), np.zeros(1, np.int32))
    >>> describe(contours, BofParams(n_points=8))[0, :4].astype(float).round(3).tolist()
    [1.0, 0.707, 1.0, 0.707]
    """
    if len(contours) == 0:
        return np.empty((0, params.n_values), np.float32)
    closed, starts, ends = _close(contours)
    step = np.zeros(len(closed))
    np.abs(closed[1:] - closed[:-1], out=step[:-1])
    step[ends] = 0.0
    centroids, clockwise = _centroids(closed, starts, ends, step)
    if params.sampling == "arc":
        sampled = _sample_by_arc(closed, starts, ends, step, clockwise, params.n_points)
        radii = np.abs(sampled - centroids[:, None])
    else:
        radii = np.stack(
            [
                _radii_by_angle(closed[start : end + 1] - centroid, params.n_points)
                for start, end, centroid in zip(starts, ends, centroids, strict=True)
            ]
        )
    largest = radii.max(axis=1, keepdims=True)
    radii /= np.where(largest > POINT_PX, largest, np.inf)
    if params.start == "farthest":
        first = radii.argmax(axis=1)[:, None]
        shifted = (first + np.arange(params.n_points)) % params.n_points
        radii = np.take_along_axis(radii, shifted, axis=1)
    elif params.start == "fourier":
        radii = np.abs(np.fft.rfft(radii, axis=1)) / params.n_points
    return radii.astype(np.float32)


def _close(contours: Contours) -> tuple[Complex, NDArray[np.intp], NDArray[np.intp]]:
    """Return all points x + iy (S,), each contour's first repeated at its end.

    Also the places of each contour's first point and of its repetition, (C,) both.
    """
    counts = np.array([len(points) for points in contours.points_px])
    if counts.min() == 0:
        raise ValueError("a contour must have at least one point, got one with none")
    points = [part for points in contours.points_px for part in (points, points[:1])]
    closed: Complex = np.concatenate(points).astype(np.float64).view(np.complex128)[:, 0]
    ends = np.cumsum(counts + 1) - 1
    return closed, ends - counts, ends


def _centroids(
    closed: Complex, starts: NDArray[np.intp], ends: NDArray[np.intp], step: Array
) -> tuple[Complex, NDArray[np.bool_]]:
    """Return the centroids (C,), and which contours run clockwise (C,), by Green's theorem."""
    # Relative to each contour's first point, which keeps small far-off areas precise.
    local = closed - np.repeat(closed[starts], ends - starts + 1)
    following = np.roll(local, -1)
    cross = local.real * following.imag - local.imag * following.real
    cross[ends] = 0.0  # from the end of one contour to the start of the next
    pair = local + following
    double_area = np.add.reduceat(cross, starts)
    centroids = np.add.reduceat(pair * cross, starts)
    flat = double_area == 0.0
    centroids /= np.where(flat, 1.0, 3.0 * double_area)
    if flat.any():
        length = np.add.reduceat(step, starts)
        middle = np.add.reduceat(0.5 * pair * step, starts) / np.where(length > 0, length, 1.0)
        centroids = np.where(flat, middle, centroids)
    return closed[starts] + centroids, double_area > 0.0


def _sample_by_arc(
    closed: Complex,
    starts: NDArray[np.intp],
    ends: NDArray[np.intp],
    step: Array,
    clockwise: NDArray[np.bool_],
    n: int,
) -> Complex:
    """Return n points of each contour (C, n) at equal arc length, counter-clockwise."""
    # Arc length along all contours one after the other, one pixel of gap between two, so that
    # one interpolation serves them all.
    gapped = step.copy()
    gapped[ends] = 1.0
    arc = np.cumsum(gapped) - gapped
    begin, length = arc[starts], arc[ends] - arc[starts]
    along = begin[:, None] + np.arange(n) / n * length[:, None]
    # Walked backwards from the same first point where the contour was found clockwise.
    along[clockwise, 1:] = along[clockwise, :0:-1]
    sampled: Complex = np.interp(along, arc, closed)
    return sampled


def _radii_by_angle(closed: Complex, n: int, block: int = 512) -> Array:
    """Return the distance to the farthest crossing with each of n rays from the origin.

    ``closed`` are the corners (M,) of a closed polygon relative to its centroid.
    """
    radii = np.zeros(n)
    rays = np.exp(-2j * np.pi * np.arange(n) / n)[:, None]  # y points down
    for begin in range(0, len(closed) - 1, block):
        # Turned so that the ray is the positive real axis, which an edge crosses where its
        # ends lie on different sides.
        corners = closed[begin : begin + block + 1] * rays.conj()
        a, b = corners[:, :-1], corners[:, 1:]
        crosses = (a.imag < 0) != (b.imag < 0)
        rise = np.where(crosses, b.imag - a.imag, 1.0)
        where = np.where(crosses, a.real - a.imag * (b.real - a.real) / rise, 0.0)
        radii = np.maximum(radii, where.max(axis=1, initial=0.0))
    return radii
