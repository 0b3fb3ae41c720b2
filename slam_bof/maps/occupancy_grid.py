"""An occupancy grid of the map's depth images, in the format of ROS's map_server.

A cell is occupied where keyframes see an obstacle in it, free where they look across it to the
floor or to an obstacle behind it, and unknown elsewhere.
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

__all__ = ["OccupancyGrid", "OccupancyGridParams", "build_occupancy_grid", "write_occupancy_grid"]

FREE, OCCUPIED, UNKNOWN = 254, 0, 205
"""Grey values of map_server."""
DEFAULT_CAMERA_HEIGHT_M = 1.4
"""Assumed height of the camera above the floor where no floor is seen."""
MIN_LEVEL_COSINE = 0.9
"""Smallest cosine between the normal of a level surface and up."""
MIN_FLOOR_RATIO = 0.05
"""The floor is the lowest level surface with at least this share of the points of the largest."""
N_AZIMUTHS = 720
"""Number of directions in which a keyframe's line of sight is traced."""


class OccupancyGridParams(Params):
    """Size of the cells, and what counts as an obstacle."""

    resolution_m: float = Field(0.05, gt=0, description="Side of a grid cell.")
    min_height_m: float = Field(
        0.1, description="Height above the floor up to which a point belongs to the floor."
    )
    max_height_m: float = Field(
        2.0, description="Height above the floor from which points are no obstacles."
    )
    max_range_m: float = Field(4.0, gt=0, description="Largest distance of points that are used.")
    min_points: int = Field(
        3, gt=0, description="Points of one keyframe that make an obstacle in a cell."
    )
    min_share: float = Field(
        0.3,
        gt=0,
        le=1,
        description="Share of the keyframes that observe a cell which must see an obstacle in it.",
    )


@dataclass(frozen=True, slots=True, eq=False)
class OccupancyGrid:
    """Cells (rows, columns) uint8 with the grey values of map_server; row 0 has the largest y.

    The plan frame follows REP-103: x points ahead of the first camera, y to its left, z up.
    ``T_plan_map`` (4, 4) takes coordinates of the map frame to it. ``origin_m`` is the lower left
    corner of the grid in the plan frame. Where ``floor_seen`` is False, heights assume a camera
    1.4 m above the floor.
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin_m: tuple[float, float]
    T_plan_map: Pose
    floor_seen: bool


def build_occupancy_grid(
    frames: Iterable[DepthFrame],
    T_map_camera: Array,
    params: OccupancyGridParams | None = None,
    *,
    gravity_map: ArrayLike = (0.0, 1.0, 0.0),
) -> OccupancyGrid:
    """Build the occupancy grid of keyframes.

    Parameters
    ----------
    frames, T_map_camera
        K depth frames, which may be subsampled, and their poses (K, 4, 4).
    params
        Size of the cells and heights of obstacles.
    gravity_map
        (3,) approximate direction of gravity in the map frame.

    Raises
    ------
    MapError
        If the frames show no surface, or nothing within range.
    """
    p = params or OccupancyGridParams()
    frames = list(frames)
    if not any(make_view(frame).normals_camera.any() for frame in frames):
        raise MapError(f"found no surface in {len(frames)} keyframes, expected some to draw")
    T_plan_map, floor_seen = plan_frame(frames, T_map_camera, gravity_map=gravity_map)
    observations = [
        _KeyframeObservation(frame, T_plan_map @ T, p)
        for frame, T in zip(frames, T_map_camera, strict=True)
    ]
    observations = [o for o in observations if len(o.points)]
    if not observations:
        raise MapError(
            f"found nothing within {p.max_range_m:g} m in {len(frames)} keyframes, expected walls"
        )
    extents = np.concatenate([np.vstack([o.points[:, :2], o.camera]) for o in observations])
    low, high = extents.min(axis=0), extents.max(axis=0)
    low = np.floor(low / p.resolution_m - 1) * p.resolution_m
    width, height = (np.ceil((high - low) / p.resolution_m).astype(int) + 1).tolist()
    hits = np.zeros((height, width), np.int32)
    misses = np.zeros((height, width), np.int32)
    for observation in observations:
        occupied = observation.occupied(low, hits.shape)
        hits += occupied
        misses += observation.free(low, hits.shape) & ~occupied
    n_observed = hits + misses
    cells = np.full(hits.shape, UNKNOWN, np.uint8)
    cells[n_observed > 0] = FREE
    cells[(hits > 0) & (hits >= p.min_share * n_observed)] = OCCUPIED
    origin_m = (float(low[0]), float(low[1]))
    return OccupancyGrid(cells[::-1].copy(), p.resolution_m, origin_m, T_plan_map, floor_seen)


def write_occupancy_grid(path: Path, grid: OccupancyGrid) -> None:
    """Write ``path`` (YAML for ROS's map_server) and a PNG of the same name beside it."""
    image = path.with_suffix(".png")
    values = {
        "image": image.name,
        "resolution": grid.resolution_m,
        "origin": [*grid.origin_m, 0.0],
        "negate": 0,
        "occupied_thresh": 0.65,
        "free_thresh": 0.196,
        "mode": "trinary",
        # x ahead of the first camera, y left, z up; map_server ignores it.
        "T_plan_map": grid.T_plan_map.tolist(),
    }
    _, png = cv2.imencode(".png", grid.cells)
    image.write_bytes(png.tobytes())
    text = yaml.safe_dump(values, sort_keys=False, default_flow_style=None)
    path.write_text(text, encoding="utf-8")


class _KeyframeObservation:
    """The points that a keyframe sees, in the plan frame."""

    def __init__(self, frame: DepthFrame, T_plan_camera: Pose, params: OccupancyGridParams) -> None:
        points = view_points(frame)
        points = points[np.linalg.norm(points, axis=1) < params.max_range_m]
        self.points: Array = se3.transform(T_plan_camera, points.astype(np.float64))
        self.camera: Array = T_plan_camera[:2, 3]
        self._params = params
        height = self.points[:, 2]
        self._is_obstacle = (height > params.min_height_m) & (height < params.max_height_m)
        self._is_floor = np.abs(height) <= params.min_height_m

    def occupied(self, low: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the mask of cells in which the keyframe sees an obstacle."""
        cells = self._cells(self.points[self._is_obstacle, :2], low)
        counts = np.bincount(cells[:, 1] * shape[1] + cells[:, 0], minlength=shape[0] * shape[1])
        return np.asarray(counts.reshape(shape) >= self._params.min_points)

    def free(self, low: Array, shape: tuple[int, ...]) -> NDArray[np.bool_]:
        """Return the mask of cells on the lines of sight to the nearest obstacle or to the floor.

        Floor seen behind an obstacle does not count: keyframes with a free view of it decide.
        """
        ahead = self.points[:, :2] - self.camera
        distance = np.linalg.norm(ahead, axis=1)
        turn = np.arctan2(ahead[:, 1], ahead[:, 0]) / (2 * np.pi) * N_AZIMUTHS
        azimuth = np.floor(turn).astype(np.intp) % N_AZIMUTHS
        reach = np.zeros(N_AZIMUTHS)
        np.maximum.at(reach, azimuth[self._is_floor], distance[self._is_floor])
        nearest = np.full(N_AZIMUTHS, np.inf)
        np.minimum.at(nearest, azimuth[self._is_obstacle], distance[self._is_obstacle])
        reach = np.where(np.isfinite(nearest), nearest, reach)
        mask = np.zeros(shape, np.uint8)
        edges = 2 * np.pi * np.arange(N_AZIMUTHS + 1) / N_AZIMUTHS
        rays = np.stack([np.cos(edges), np.sin(edges)], axis=-1)
        for k in np.flatnonzero(reach > 0):
            corners = self.camera + reach[k] * rays[k : k + 2]
            triangle = self._cells(np.vstack([self.camera, corners]), low)
            cv2.fillConvexPoly(mask, triangle.astype(np.int32), 1)
        return mask.astype(bool)

    def _cells(self, points: Array, low: Array) -> NDArray[np.intp]:
        """Return the column and row (N, 2) of points (N, 2), row 0 at the bottom."""
        return np.floor((points - low) / self._params.resolution_m).astype(np.intp)


def plan_frame(
    frames: Iterable[DepthFrame],
    T_map_camera: Array,
    *,
    gravity_map: ArrayLike = (0.0, 1.0, 0.0),
) -> tuple[Pose, bool]:
    """Return ``T_plan_map`` (4, 4) with z = 0 on the floor, and whether the floor was seen.

    Parameters are those of ``build_occupancy_grid``; frames must show some surface.
    """
    frames, down = list(frames), np.asarray(gravity_map, np.float64)
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
    level = np.concatenate(normals_map) @ -down > MIN_LEVEL_COSINE
    heights_m = se3.transform(T_plan_map, np.concatenate(points_map)[level])[:, 2]
    floor_m = _find_floor(heights_m, cameras_m)
    T_plan_map[2, 3] = (
        DEFAULT_CAMERA_HEIGHT_M - np.median(cameras_m) if floor_m is None else -floor_m
    )
    return T_plan_map, floor_m is not None


def _find_floor(heights_m: Array, cameras_m: Array, step_m: float = 0.05) -> float | None:
    """Return the height of the lowest large level surface below the cameras, None without one."""
    below = heights_m[heights_m < np.median(cameras_m) - 0.2]
    if not len(below):
        return None
    first = below.min() - step_m
    counts = np.bincount(((below - first) / step_m).astype(np.intp))
    counts = counts + np.append(counts[1:], 0)  # the floor may lie across two bins
    large = np.flatnonzero(counts >= MIN_FLOOR_RATIO * counts.max())
    low = first + large[0] * step_m
    return float(np.median(below[(below >= low) & (below < low + 2 * step_m)]))
