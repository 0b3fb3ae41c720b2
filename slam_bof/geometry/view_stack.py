"""Storage of many depth views of one camera.

A view keeps its id for good. The memory of a dropped view is used for the next one.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray, compiled
from slam_bof.geometry.depth_view import DepthView
from slam_bof.geometry.projection import NORMAL_STEPS, ViewArrays
from slam_bof.types import Intrinsics

__all__ = ["Floats", "Indices", "ViewStack"]

Indices = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]

DROPPED = -1
"""Row of views that were dropped."""


class ViewStack:
    """Stores the depths and normals of views, and a random sample of the pixels of each."""

    def __init__(self, n_points: int, *, seed: int = 0) -> None:
        self.n_points = n_points
        self._seed = seed
        self._camera: Intrinsics | None = None
        self._row_of_id = GrowingArray((), np.int32)
        self._free_rows: list[int] = []
        self._rays: NDArray[np.float32]
        self._depths_m: GrowingArray
        self._normals: GrowingArray
        self._sampled: GrowingArray
        self._surface: GrowingArray
        self._roughness: GrowingArray
        self._order: Indices

    def add(self, view: DepthView) -> None:
        """Store another view; ids count from 0.

        Raises
        ------
        ValueError
            If its camera differs from that of the views before.
        """
        if self._camera is None:
            n_pixels = view.depth_m.size
            self._camera = view.intrinsics
            self._rays = view.rays().reshape(-1, 3)
            self._depths_m = GrowingArray((n_pixels,), np.float32)
            self._normals = GrowingArray((n_pixels, 3), np.int8)
            self._sampled = GrowingArray((self.n_points,), np.int32)
            self._surface = GrowingArray((self.n_points,), np.int32)
            self._roughness = GrowingArray((), np.float64)
            self._order = np.random.default_rng(self._seed).permutation(n_pixels)
        if view.intrinsics != self._camera:
            raise ValueError(f"views must be of {self._camera}, got {view.intrinsics}")
        depth_m = np.ascontiguousarray(view.depth_m).reshape(-1)
        normals = np.ascontiguousarray(view.normals_camera).reshape(-1, 3)
        row = self._free_rows.pop() if self._free_rows else len(self._depths_m)
        for stack, values in (
            (self._depths_m, depth_m),
            (self._normals, np.rint(normals * NORMAL_STEPS)),
            (self._sampled, _sample(depth_m[:, None], self._order, self.n_points)),
            (self._surface, _sample(normals, self._order, self.n_points)),
            (self._roughness, np.float64(view.roughness)),
        ):
            if row == len(stack):
                stack.append(values)
            else:
                stack.rows[row] = values  # in place: nothing reads a row that is free
        self._row_of_id.append(row)

    def __len__(self) -> int:
        """Return the number of views added so far, dropped ones included: the next id."""
        return len(self._row_of_id)

    def drop(self, view_id: int) -> None:
        """Drop a view; ``KeyError`` if there is none of that id."""
        if not 0 <= view_id < len(self) or self._row_of_id.rows[view_id] == DROPPED:
            raise KeyError(f"no view {view_id}")
        self._free_rows.append(int(self._row_of_id.rows[view_id]))
        self._row_of_id.put(view_id, DROPPED)

    def truncate(self, n: int) -> None:
        """Keep only the views with ids below ``n``; the next id is ``n``."""
        dropped = self._row_of_id.rows[n:]
        self._free_rows += dropped[dropped != DROPPED].tolist()
        self._row_of_id.truncate(n)
        if self._camera is None:
            return
        n_rows = int(self._row_of_id.rows.max(initial=DROPPED)) + 1
        for stack in self._stacks():
            stack.truncate(n_rows)
        self._free_rows = [row for row in self._free_rows if row < n_rows]

    @property
    def nbytes(self) -> int:
        """Size of all stored views in bytes, dropped ones not included."""
        if self._camera is None:
            return 0
        n_stored = len(self._depths_m) - len(self._free_rows)
        return n_stored * sum(stack.rows.strides[0] for stack in self._stacks())

    def points_camera(self, view_id: int) -> NDArray[np.float32]:
        """Return all points (N, 3) of a view."""
        depth_m = self._depths_m.rows[self.rows(view_id)]
        return np.asarray((self._rays * depth_m[:, None])[depth_m > 0])

    def sampled(self, views: int | Indices, n_points: int | None = None) -> Floats:
        """Return sampled points (m, 3) of a view, or (n, m, 3) of views (n,)."""
        rows = self.rows(views)
        return self._points(rows[..., None], self._sampled.rows[rows, :n_points])

    def surface(self, view_id: int, n_points: int | None = None) -> tuple[Floats, Floats]:
        """Return sampled points (m, 3) of a view with known normals, and the normals (m, 3)."""
        row = self.rows(view_id)
        pixels = self._surface.rows[row, :n_points]
        normals = self._normals.rows[row].take(pixels, axis=0) * np.float32(1 / NORMAL_STEPS)
        return self._points(row, pixels), normals

    def surface_points(self, views: int | Indices) -> Floats:
        """Return sampled points with known normals: (m, 3) of a view or (n, m, 3) of views (n,)."""
        rows = self.rows(views)
        return self._points(rows[..., None], self._surface.rows[rows])

    def arrays(self) -> ViewArrays:
        """Return what compiled functions take; views are its rows (see ``rows``)."""
        assert self._camera is not None
        camera = self._camera
        return ViewArrays(
            depths_m=self._depths_m.rows,
            normals=self._normals.rows,
            sampled=self._sampled.rows,
            rays=self._rays,
            roughness=self._roughness.rows,
            width=camera.width,
            height=camera.height,
            fx=camera.fx,
            fy=camera.fy,
            cx=camera.cx,
            cy=camera.cy,
        )

    def rows(self, views: int | Indices) -> Indices:
        """Return the rows of views in the arrays; ``KeyError`` if one was dropped."""
        rows = np.asarray(self._row_of_id.rows[views], np.intp)
        if (rows == DROPPED).any():
            raise KeyError(f"a view of {views} was dropped")
        return rows

    def _stacks(self) -> tuple[GrowingArray, ...]:
        return self._depths_m, self._normals, self._sampled, self._surface, self._roughness

    def _points(self, rows: Indices, pixels: Indices) -> Floats:
        addresses = rows * len(self._rays) + pixels
        depth_m = self._depths_m.rows.reshape(-1).take(addresses)
        return np.asarray(self._rays.take(pixels, axis=0) * depth_m[..., None])


@compiled
def _sample(known: Floats, order: Indices, n_points: int) -> NDArray[np.int32]:
    """Return the first ``n_points`` pixels of an order at which anything is known, not 0.

    ``known`` is (pixels, n). They are repeated if they are too few; any are taken if there is none.
    """
    chosen = np.empty(n_points, np.int32)
    n = 0
    for pixel in order:
        if n == n_points:
            break
        if known[pixel].any():
            chosen[n] = pixel
            n += 1
    if n == 0:
        n = min(n_points, len(order))
        chosen[:n] = order[:n]
    for k in range(n, n_points):
        chosen[k] = chosen[k - n]
    return chosen
