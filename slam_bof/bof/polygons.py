"""Many closed polygons at once: centroids, lengths, and radii by angle.

Corners are complex numbers, and all polygons lie one after the other in one array: a view has
some hundred contours, and a loop over them in Python would take longer than what it computes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from slam_bof.types import Array

__all__ = ["Polygons"]

Complex = NDArray[np.complex128]


class Polygons:
    """Closed polygons, whose centroids (by the enclosed area) and lengths are known.

    Parameters
    ----------
    corners
        (S,) complex128, those of all P polygons, in order.
    counts
        (P,) of how many corners each has, at least one.

    Attributes
    ----------
    centroids : (P,) complex128
        Of a polygon that encloses no area it is the mean of its corners.
    lengths : (P,) float64
    """

    def __init__(self, corners: Complex, counts: NDArray[np.intp]) -> None:
        starts = np.cumsum(counts) - counts
        begins, ends = corners, np.roll(corners, -1)
        ends[starts + counts - 1] = begins[starts]
        self._counts, self._starts, self._begins, self._ends = counts, starts, begins, ends
        first = np.repeat(begins[starts], counts)
        a, b = begins - first, ends - first
        cross = a.real * b.imag - a.imag * b.real
        double_area = self._sum(cross)
        flat = np.abs(double_area) < 1e-12
        moment = self._sum((a + b) * cross) / np.where(flat, 1.0, 3.0 * double_area)
        mean = self._sum(a) / np.maximum(counts, 1)
        self.centroids: Complex = begins[starts] + np.where(flat, mean, moment)
        self.lengths: Array = self._sum(np.abs(ends - begins)).real

    def __len__(self) -> int:
        """Return the number of polygons."""
        return len(self._counts)

    def largest_radii(self) -> Array:
        """Return the distance (P,) from the centroid to the farthest corner."""
        distances = np.abs(self._begins - np.repeat(self.centroids, self._counts))
        return np.maximum.reduceat(distances, self._starts) if len(self) else np.empty(0)

    def radii(self, chosen: NDArray[np.intp], n: int) -> Array:
        """Return the distance (C, n) to the farthest crossing with each of n rays.

        Ray k leaves the centroid of a chosen (C,) polygon at angle 2 pi k / n, from the real
        axis towards the imaginary one; 0 where it crosses nothing.
        """
        radii = np.zeros((len(chosen), n))
        counts = self._counts[chosen]
        which = np.repeat(np.arange(len(chosen)), counts)
        within = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
        edges = self._starts[chosen][which] + within
        centroids = self.centroids[chosen][which]
        a, b = self._begins[edges] - centroids, self._ends[edges] - centroids
        # From one end of an edge to the other is less than half a turn: it crosses the rays
        # with whole numbers between.
        start = np.angle(a) * (n / (2 * np.pi))
        turn = np.angle(b * a.conj()) * (n / (2 * np.pi))
        low = np.floor(np.minimum(start, start + turn)).astype(np.intp)
        high = np.floor(np.maximum(start, start + turn)).astype(np.intp)
        n_rays = high - low
        edge = np.repeat(np.arange(len(edges)), n_rays)
        ray = np.arange(len(edge)) - np.repeat(np.cumsum(n_rays) - n_rays, n_rays)
        ray = (ray + low[edge] + 1) % n
        along = (b - a)[edge]
        direction = np.exp(2j * np.pi * np.arange(n) / n)[ray]
        area = (a.conj() * b).imag[edge]
        slope = direction.real * along.imag - direction.imag * along.real
        distance = np.divide(area, slope, out=np.zeros(len(edge)), where=slope != 0)
        np.maximum.at(radii.reshape(-1), which[edge] * n + ray, distance)
        return radii

    def _sum(self, values: NDArray[np.inexact]) -> NDArray[np.inexact]:
        """Add up (S,) what each polygon's edges have, (P,)."""
        return np.add.reduceat(values, self._starts) if len(self) else values[:0]
