"""A plan of where one can go: the map's depth images in cells, as ROS has its maps.

A cell is occupied where something stands in it between knee and head, free where keyframes look
across it to the floor or to what stands behind, else unknown.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from slam_bof.errors import MapError
from slam_bof.geometry import down_of_map, level_frame, make_view, se3, view_points
from slam_bof.types import Array, DepthFrame, Params, Pose

__all__ = ["OccupancyGrid", "OccupancyParams", "make_grid", "write_grid"]

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values, as map_server has them."""
USUAL_HEIGHT_M = 1.4
"""Of the camera, where no floor is seen."""
UP_COSINE = 0.9
FLOOR_SHARE = 0.05
"""Of the largest level surface, that the floor must have in sight; it is the lowest of those."""
AZIMUTHS = 720
"""Directions in which a keyframe looks across cells."""


class OccupancyParams(Params):
    """How large cells are, and what counts as standing in them."""

    resolution_m: float = Field(0.05, gt=0, description="side of a cell")
    min_height_m: float = Field(0.1, description="above the floor: lower is floor")
    max_height_m: float = Field(2.0, description="above the floor: higher is passed under")
    max_range_m: float = Field(4.0, gt=0, description="farther depths are not trusted")
    min_points: int = Field(3, gt=0, description="of a keyframe in a cell, to be something")
    min_share: float = Field(
        0.3, gt=0, le=1, description="of the keyframes that tell, to see something in a cell"
    )


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """Cells (rows, columns) uint8 with the grey values of map_server; row 0 has the largest y.

    The plan's frame is as REP-103 has it: x ahead of the first camera, y to its left, z up;
    ``T_plan_map`` (4, 4) leads there from the map's. ``origin_m`` is the lower left corner.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin_m: tuple[float, float]
    T_plan_map: Pose
    floor_seen: bool


def make_grid(
    frames: Iterable[DepthFrame],
    T_map_camera: Array,
    params: OccupancyParams | None = None,
    *,
    gravity_map: ArrayLike = (0.0, 1.0, 0.0),
) -> OccupancyGrid:
    """Draw the plan of keyframes.

    Parameters
    ----------
    frames, T_map_camera
        K depth frames, of which every few pixels are enough, and their poses (K, 4, 4).
    params
        Of the plan.
    gravity_map
        (3,) roughly down in the map's frame.

    Raises
    ------
    MapError
        If they show nothing within range.
    """
    p = params or OccupancyParams()
    frames = list(frames)
    if not any(make_view(frame).normals_camera.any() for frame in frames):
        raise MapError(f"found no surface in {len(frames)} keyframes, expected some to draw")
    T_plan_map, floor_seen = _level(frames, T_map_camera, np.asarray(gravity_map, np.float64))
    seen = [_Seen(frame, T_plan_map @ T, p) for frame, T in zip(frames, T_map_camera, strict=True)]
    seen = [one for one in seen if len(one.points)]
    if not seen:
        raise MapError(
            f"found nothing within {p.max_range_m:g} m in {len(frames)} keyframes, expected walls"
        )
    low = np.min([np.min([one.points[:, :2].min(axis=0), one.camera], axis=0) for one in seen], 0)
    high = np.max([np.max([one.points[:, :2].max(axis=0), one.camera], axis=0) for one in seen], 0)
    low = np.floor(low / p.resolution_m - 1) * p.resolution_m
    width, height = (np.ceil((high - low) / p.resolution_m).astype(int) + 1).tolist()
    hits = np.zeros((height, width), np.int32)
    misses = np.zeros((height, width), np.int32)
    for one in seen:
        occupied = one.occupied(low, hits.shape)
        hits += occupied
        misses += one.free(low, hits.shape) & ~occupied
    told = hits + misses
    cells = np.full(hits.shape, UNKNOWN, np.uint8)
    cells[told > 0] = FREE
    cells[(hits > 0) & (hits >= p.min_share * told)] = OCCUPIED
    origin_m = (float(low[0]), float(low[1]))
    return OccupancyGrid(cells[::-1].copy(), p.resolution_m, origin_m, T_plan_map, floor_seen)


def write_grid(path: Path, grid: OccupancyGrid) -> None:
    """Write ``path`` (YAML, as ROS map_server reads it) and a PNG of the same name beside it."""
    image = path.with_suffix(".png")
    values = {
        "image": image.name,
        "resolution": grid.resolution_m,
        "origin": [*grid.origin_m, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        "mode": "trinary",
    }
    _, png = cv2.imencode(".png", grid.cells)
    image.write_bytes(png.tobytes())
    rows = "\n".join(f"#   {' '.join(map(repr, row))}" for row in grid.T_plan_map.tolist())
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(
        f"{text}# x ahead of the first camera, y left, z up; T_plan_map of the map's poses:\n"
        f"{rows}\n",
        encoding="utf-8",
    )


class _Seen:
    """What a keyframe sees, in the plan's frame."""

    def __init__(self, frame: DepthFrame, T_plan_camera: Pose, params: OccupancyParams) -> None:
        points = view_points(frame)
        points = points[np.linalg.norm(points, axis=1) < params.max_range_m]
        self.points: Array = se3.transform(T_plan_camera, points.astype(np.float64))
        self.camera: Array = T_plan_camera[:2, 3]
        self._params = params
        height = self.points[:, 2]
        self._stands = (height > params.min_height_m) & (height < params.max_height_m)
        self._floor = np.abs(height) <= params.min_height_m

    def occupied(self, low: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the cells in which it sees something stand."""
        cells = self._cells(self.points[self._stands, :2], low)
        counts = np.bincount(cells[:, 1] * shape[1] + cells[:, 0], minlength=shape[0] * shape[1])
        return np.asarray(counts.reshape(shape) >= self._params.min_points)

    def free(self, low: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the cells that it looks across: to the first thing that stands, or to the floor.

        What it sees of the floor behind is left to keyframes that look there.
        """
        ahead = self.points[:, :2] - self.camera
        distance = np.linalg.norm(ahead, axis=1)
        turn = np.arctan2(ahead[:, 1], ahead[:, 0]) / (2 * np.pi) * AZIMUTHS
        azimuth = np.floor(turn).astype(np.intp) % AZIMUTHS
        reach = np.zeros(AZIMUTHS)
        np.maximum.at(reach, azimuth[self._floor], distance[self._floor])
        nearest = np.full(AZIMUTHS, np.inf)
        np.minimum.at(nearest, azimuth[self._stands], distance[self._stands])
        reach = np.where(np.isfinite(nearest), nearest, reach)
        mask = np.zeros(shape, np.uint8)
        edges = 2 * np.pi * np.arange(AZIMUTHS + 1) / AZIMUTHS
        rays = np.stack([np.cos(edges), np.sin(edges)], axis=-1)
        looked = np.flatnonzero(reach > 0)
        for k in looked:
            corners = self.camera + reach[k] * rays[k : k + 2]
            triangle = self._cells(np.vstack([self.camera, corners]), low)
            cv2.fillConvexPoly(mask, triangle.astype(np.int32), 1)
        return mask.astype(bool)

    def _cells(self, points: Array, low: Array) -> NDArray[np.intp]:
        """Return the column and row (N, 2) of points (N, 2), row 0 at the bottom."""
        return np.floor((points - low) / self._params.resolution_m).astype(np.intp)


def _level(frames: list[DepthFrame], T_map_camera: Array, down: Array) -> tuple[Pose, bool]:
    """Return ``T_plan_map`` (4, 4), z = 0 on the floor, and whether the floor was seen."""
    normals_map, points_map = [], []
    for frame, T in zip(frames, T_map_camera, strict=True):
        view = make_view(frame)
        known = view.normals_camera.any(axis=-1)
        normals_map.append(view.normals_camera[known] @ T[:3, :3].T)
        points = (view.rays() * view.depth_m[..., None])[known]
        points_map.append(se3.transform(T, points.astype(np.float64)))
    right, down, ahead = level_frame(down_of_map(frames, T_map_camera, down))
    T_plan_map = se3.pose(np.stack([ahead, -right, -down]), np.zeros(3))
    cameras_m = se3.transform(T_plan_map, T_map_camera[:, :3, 3])[:, 2]
    level = np.concatenate(normals_map) @ -down > UP_COSINE
    heights_m = se3.transform(T_plan_map, np.concatenate(points_map)[level])[:, 2]
    floor_m = _floor(heights_m, cameras_m)
    T_plan_map[2, 3] = USUAL_HEIGHT_M - np.median(cameras_m) if floor_m is None else -floor_m
    return T_plan_map, floor_m is not None


def _floor(heights_m: Array, cameras_m: Array, step_m: float = 0.05) -> float | None:
    """Return the height of the lowest large level surface below the cameras, if there is one."""
    below = heights_m[heights_m < np.median(cameras_m) - 0.2]
    if not len(below):
        return None
    first = below.min() - step_m
    counts = np.bincount(((below - first) / step_m).astype(np.intp))
    counts = counts + np.append(counts[1:], 0)  # a floor may lie across two steps
    enough = np.flatnonzero(counts >= FLOOR_SHARE * counts.max())
    low = first + enough[0] * step_m
    return float(np.median(below[(below >= low) & (below < low + 2 * step_m)]))
