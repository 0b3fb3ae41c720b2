"""Storage of many depth views of one camera, and projection of points into them.

A view keeps its id for good. The memory of a dropped view is used for the next one.

Coordinates are stored in separate contiguous float32 arrays, so that computations run along
contiguous memory.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.core import GrowingArray
from slam_bof.geometry.depth_view import DepthView
from slam_bof.types import Intrinsics

__all__ = ["Floats", "Indices", "ProjectedPoints", "ViewStack"]

Indices = NDArray[np.integer[Any]]
Floats = NDArray[np.floating[Any]]

DROPPED = -1
"""Row of views that were dropped."""

NEAR_M = np.float32(0.05)
"""Points nearer than this are not projected."""
NORMAL_STEPS = 127
"""Number of steps per unit in which normals are stored as bytes."""


MAX_STEP = np.float32(0.03)
"""Pixels whose depths differ by less than this share of (1 m + depth) are on one surface."""
MAX_BEND = np.float32(0.03)
"""So are three in a row whose inverse depths deviate from a line by less than this share."""


class ProjectedPoints(NamedTuple):
    """Projections of points into images; each array is (n, m)."""

    column: Floats
    """Column of the nearest pixel."""
    row: Floats
    """Row of the nearest pixel."""
    column_offset: Floats
    """Offset of the projection from that pixel in columns, -0.5 to 0.5."""
    row_offset: Floats
    """The same in rows."""
    depth_m: Floats
    """Depth of the points, not of the image."""
    inside: NDArray[np.bool_]
    """Whether the points lie within the image."""


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
            self._order = np.random.default_rng(self._seed).permutation(n_pixels)
        if view.intrinsics != self._camera:
            raise ValueError(f"views must be of {self._camera}, got {view.intrinsics}")
        normals = view.normals_camera.reshape(-1, 3)
        row = self._free_rows.pop() if self._free_rows else len(self._depths_m)
        for stack, values in (
            (self._depths_m, view.depth_m.reshape(-1)),
            (self._normals, np.rint(normals * NORMAL_STEPS)),
            (self._sampled, self._sample(view.depth_m.reshape(-1) > 0)),
            (self._surface, self._sample(np.asarray(normals.any(axis=1)))),
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
        for stack in (self._depths_m, self._normals, self._sampled, self._surface):
            stack.truncate(n_rows)
        self._free_rows = [row for row in self._free_rows if row < n_rows]

    @property
    def nbytes(self) -> int:
        """Size of all stored views in bytes, dropped ones not included."""
        if self._camera is None:
            return 0
        stacks = (self._depths_m, self._normals, self._sampled, self._surface)
        n_stored = len(self._depths_m) - len(self._free_rows)
        return n_stored * sum(stack.rows.strides[0] for stack in stacks)

    def points_camera(self, view_id: int) -> NDArray[np.float32]:
        """Return all points (N, 3) of a view."""
        depth_m = self._depths_m.rows[self._rows(view_id)]
        return np.asarray((self._rays * depth_m[:, None])[depth_m > 0])

    def sampled(self, views: int | Indices, n_points: int | None = None) -> Floats:
        """Return sampled points (m, 3) of a view, or (n, m, 3) of views (n,)."""
        rows = self._rows(views)
        return self._points(rows[..., None], self._sampled.rows[rows, :n_points])

    def surface(self, view_id: int, n_points: int | None = None) -> tuple[Floats, Floats]:
        """Return sampled points (m, 3) of a view with known normals, and the normals (m, 3)."""
        row = self._rows(view_id)
        pixels = self._surface.rows[row, :n_points]
        normals = self._normals.rows[row].take(pixels, axis=0) * np.float32(1 / NORMAL_STEPS)
        return self._points(row, pixels), normals

    def surface_points(self, views: int | Indices) -> Floats:
        """Return sampled points with known normals: (m, 3) of a view or (n, m, 3) of views (n,)."""
        rows = self._rows(views)
        return self._points(rows[..., None], self._surface.rows[rows])

    def project_points(self, points: Floats, T: Floats) -> ProjectedPoints:
        """Project points (m, 3), or (n, m, 3), into images (n,) by ``T_image_points`` (n, 4, 4)."""
        assert self._camera is not None
        camera = self._camera
        # Intrinsics times pose gives column * depth, row * depth and depth: (3, n, 4).
        project = T[:, :3].transpose(1, 0, 2).copy()
        project[0] = np.float32(camera.fx) * project[0] + np.float32(camera.cx) * project[2]
        project[1] = np.float32(camera.fy) * project[1] + np.float32(camera.cy) * project[2]
        ones = np.ones_like(points[..., :1])
        extended = np.concatenate([points, ones], axis=-1).swapaxes(-1, -2)
        if points.ndim == 2:
            column, row, depth = (project.reshape(-1, 4) @ extended).reshape(3, len(T), -1)
        else:
            column, row, depth = (project.transpose(1, 0, 2) @ extended).transpose(1, 0, 2)
        inverse = np.maximum(depth, NEAR_M)
        np.divide(np.float32(1.0), inverse, out=inverse)
        column *= inverse
        row *= inverse
        column_offset, row_offset = column, row
        column, row = np.rint(column), np.rint(row)
        column_offset -= column
        row_offset -= row
        inside = depth > NEAR_M
        inside &= column >= 0
        inside &= column < camera.width
        inside &= row >= 0
        inside &= row < camera.height
        return ProjectedPoints(column, row, column_offset, row_offset, depth, inside)

    def depth_at(self, views: int | Indices, projected: ProjectedPoints) -> tuple[Floats, Indices]:
        """Return the depths (n, m) of views (n,) at projected points, 0 outside, and flat indices.

        ``take`` from flat arrays is three times as fast as indexing by views and pixels.
        """
        assert self._camera is not None
        pixels = projected.row * np.float32(self._camera.width)
        pixels += projected.column
        pixels *= projected.inside
        addresses = pixels.astype(np.intp)
        addresses += self._rows(views)[..., None] * len(self._rays)
        depth_m = self._depths_m.rows.reshape(-1).take(addresses)
        depth_m *= projected.inside
        return depth_m, addresses

    def interpolated_depth_at(
        self, views: int | Indices, projected: ProjectedPoints
    ) -> tuple[Floats, Indices]:
        """Return the result of ``depth_at``, interpolated between pixels on the same surface.

        The inverse depth of a plane is linear in the image. Without interpolation, the depth of a
        wall at a grazing angle may be off by decimetres, and views would seem to agree best where
        their pixels coincide. At an edge the surface of the nearest pixel is continued. A pixel
        that is on no surface has depth 0.
        """
        assert self._camera is not None
        width = self._camera.width
        depth_m, addresses = self.depth_at(views, projected)
        inverse = np.zeros_like(depth_m)
        np.divide(np.float32(1.0), depth_m, out=inverse, where=depth_m > 0)
        change = np.zeros_like(depth_m)
        for offset, step in ((projected.column_offset, 1), (projected.row_offset, width)):
            towards = np.where(offset > 0, step, -step)
            ahead = self._inverse_depth_at(addresses + towards) - inverse
            behind = inverse - self._inverse_depth_at(addresses - towards)
            limit = MAX_STEP * (inverse + np.square(inverse))
            is_same = np.abs(ahead) < limit
            is_same |= np.abs(ahead - behind) < MAX_BEND * inverse
            is_same_behind = np.abs(behind) < limit
            slope = np.where(is_same, ahead, np.where(is_same_behind, behind, 0.0))
            change += np.abs(offset) * slope
            depth_m *= is_same | is_same_behind
        inverse += change
        np.divide(np.float32(1.0), inverse, out=depth_m, where=depth_m > 0)
        return depth_m, addresses

    def surface_at(self, views: Indices, projected: ProjectedPoints) -> tuple[Floats, Floats]:
        """Return the points and normals (n, 3, m) of views (n,) at projected points."""
        assert self._camera is not None
        camera = self._camera
        depth, addresses = self.depth_at(views, projected)
        points = np.empty((len(views), 3, depth.shape[1]), np.float32)
        for k, pixel, focal, centre in (
            (0, projected.column, camera.fx, camera.cx),
            (1, projected.row, camera.fy, camera.cy),
        ):
            np.subtract(pixel, np.float32(centre), out=points[:, k])
            points[:, k] *= np.float32(1.0 / focal)
            points[:, k] *= depth
        points[:, 2] = depth
        normals = np.empty_like(points)
        found = self._normals.rows.reshape(-1, 3).take(addresses, axis=0)
        np.multiply(found.transpose(0, 2, 1), np.float32(1 / NORMAL_STEPS), out=normals)
        return points, normals

    def _inverse_depth_at(self, addresses: Indices) -> Floats:
        """Return 1 / depth at flat indices, 0 where no depth is known."""
        depth_m = self._depths_m.rows.reshape(-1).take(addresses, mode="clip")
        inverse: Floats = np.zeros_like(depth_m)
        np.divide(np.float32(1.0), depth_m, out=inverse, where=depth_m > 0)
        return inverse

    def _rows(self, views: int | Indices) -> Indices:
        """Return the rows of views; ``KeyError`` if one was dropped."""
        rows = np.asarray(self._row_of_id.rows[views], np.intp)
        if (rows == DROPPED).any():
            raise KeyError(f"a view of {views} was dropped")
        return rows

    def _points(self, rows: Indices, pixels: Indices) -> Floats:
        addresses = rows * len(self._rays) + pixels
        depth_m = self._depths_m.rows.reshape(-1).take(addresses)
        return np.asarray(self._rays.take(pixels, axis=0) * depth_m[..., None])

    def _sample(self, is_valid: NDArray[np.bool_]) -> Indices:
        """Draw ``n_points`` valid pixels, with repetition if they are too few; any if none is."""
        chosen = self._order[is_valid[self._order]]
        return np.resize(chosen if len(chosen) else self._order, self.n_points)
