"""The point cloud of a map: points of the keyframes at their optimised poses, one per voxel."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from slam_bof.core import import_open3d
from slam_bof.geometry import back_project, down_of_map, se3, view_points
from slam_bof.maps.occupancy_grid import plan_frame
from slam_bof.ports import Dataset
from slam_bof.types import Array, DepthFrame

__all__ = ["write_keyframe_cloud", "write_sequence_cloud"]

STRIDE = 4
"""Step between the pixels used: at 3 m, those of a 640-pixel image are then 2 cm apart."""
MAX_RANGE_M = 4.0
"""Farther points are left out, because the noise of depth cameras grows with its square."""


def write_sequence_cloud(
    path: Path,
    dataset: Dataset,
    frame_indices: Sequence[int],
    T_map_camera: Array,
    *,
    with_color: bool = False,
    z_up: bool = False,
    voxel_size_m: float = 0.02,
) -> int:
    """Write the point cloud of frames of a data set and return its number of points.

    Parameters
    ----------
    path
        The .ply file to write (binary). It has no points if there are no frames or all depth is
        beyond 4 m.
    dataset, frame_indices, T_map_camera
        The frames to fuse, by index, and their (K, 4, 4) poses in the map.
    with_color
        Give points the data set's colour, which may show people.
    z_up
        Write the points in the plan frame (z up, 0 on the floor) instead of the frame of the map.
    voxel_size_m
        Side of the voxels; one point is kept in each.
    """
    if z_up and len(frame_indices):
        T_map_camera = plan_frame(map(dataset.frame, frame_indices), T_map_camera)[0] @ T_map_camera

    def coloured_clouds() -> Iterator[tuple[Array, Array | None]]:
        for index, T in zip(frame_indices, T_map_camera, strict=True):
            frame = dataset.frame(index)
            depth_m = frame.depth_m(STRIDE)
            depth_m[depth_m > MAX_RANGE_M] = 0.0
            points_camera = back_project(depth_m, frame.intrinsics, STRIDE)
            color = dataset.color(index) if with_color else None
            rgb = None if color is None else color[::STRIDE, ::STRIDE][depth_m > 0.0] / 255.0
            yield se3.transform(T, points_camera), rgb

    return _write(path, coloured_clouds(), voxel_size_m)


def write_keyframe_cloud(
    path: Path,
    frames: Iterable[DepthFrame],
    T_map_camera: Array,
    *,
    z_up: bool = False,
    voxel_size_m: float = 0.02,
) -> int:
    """Write the point cloud of a saved map's keyframes and return its number of points.

    Points are coloured by height, from blue (low) to red (high).

    Parameters
    ----------
    path, z_up, voxel_size_m
        As in ``write_sequence_cloud``.
    frames, T_map_camera
        The subsampled depth frames of K keyframes, and their poses (K, 4, 4).
    """
    frames, clouds = list(frames), []
    if z_up and frames:
        T_map_camera = plan_frame(frames, T_map_camera)[0] @ T_map_camera
    for frame, T in zip(frames, T_map_camera, strict=True):
        points = view_points(frame)
        points = points[points[:, 2] <= MAX_RANGE_M]
        clouds.append(se3.transform(T, points.astype(np.float64)))
    down = np.array([0.0, 0.0, -1.0]) if z_up else down_of_map(frames, T_map_camera)
    heights_m = -np.concatenate([cloud @ down for cloud in clouds]) if clouds else np.zeros(0)
    low, high = np.percentile(heights_m, [1.0, 99.0]) if len(heights_m) else (0.0, 1.0)
    share = np.clip((heights_m - low) / max(high - low, 1e-9), 0.0, 1.0)
    grey = np.rint(255 * share).astype(np.uint8).reshape(-1, 1)
    rgb: Array = np.zeros((0, 3))
    if len(grey):
        turbo = cv2.applyColorMap(grey, cv2.COLORMAP_TURBO)[:, 0, ::-1]
        rgb = turbo.astype(np.float64) / 255.0
    ends = np.cumsum([len(cloud) for cloud in clouds])[:-1]
    return _write(path, zip(clouds, np.split(rgb, ends), strict=True), voxel_size_m)


def _write(path: Path, clouds: Iterable[tuple[Array, Array | None]], voxel_size_m: float) -> int:
    """Write clouds of points_map (N, 3) with colours (N, 3) or None, one point per voxel."""
    o3d = import_open3d()
    fused = o3d.geometry.PointCloud()
    for points_map, rgb in clouds:
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points_map))
        if rgb is not None:
            cloud.colors = o3d.utility.Vector3dVector(rgb.astype(np.float64))
        fused += cloud.voxel_down_sample(voxel_size_m)
    fused = fused.voxel_down_sample(voxel_size_m)
    _write_ply(path, np.asarray(fused.points), np.asarray(fused.colors))
    return len(fused.points)


def _write_ply(path: Path, points: Array, colors: Array) -> None:
    """Write points (N, 3) and colours in [0, 1], (N, 3) or empty, in Open3D's format.

    Open3D itself cannot write empty clouds, and prints thousands of lines when the disk is full.
    """
    columns = [(name, "double", "<f8", points[:, k]) for k, name in enumerate("xyz")]
    if len(colors):
        rgb = np.rint(255.0 * np.clip(colors, 0.0, 1.0))
        names = ("red", "green", "blue")
        columns += [(name, "uchar", "u1", rgb[:, k]) for k, name in enumerate(names)]
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [*(f"property {kind} {name}" for name, kind, *_ in columns), "end_header", ""]
    vertices = np.empty(len(points), [(name, dtype) for name, _, dtype, _ in columns])
    for name, _, _, values in columns:
        vertices[name] = values
    path.write_bytes("\n".join(header).encode() + vertices.tobytes())
