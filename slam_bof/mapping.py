"""The map's point cloud: keyframes' points at their optimised poses, thinned to voxels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slam_bof import se3
from slam_bof.native import import_open3d
from slam_bof.points import back_project
from slam_bof.ports import Dataset
from slam_bof.types import Array

__all__ = ["write_map"]

STRIDE = 4
EMPTY = """\
ply
format binary_little_endian 1.0
element vertex 0
property double x
property double y
property double z
end_header
"""
"""What Open3D would write of no points, if it did not refuse to."""
MAX_RANGE_M = 4.0


def write_map(
    path: Path,
    dataset: Dataset,
    frame_indices: Sequence[int],
    T_map_camera: Array,
    *,
    voxel_size_m: float = 0.02,
) -> int:
    """Write ``map.ply`` and return its number of points.

    Parameters
    ----------
    path
        The .ply file to write (binary, with colour where the data set has it); without keyframes,
        or where all they see is too far, it has no points.
    dataset, frame_indices, T_map_camera
        The frames to fuse, by index, and their (K, 4, 4) poses in the map.
    voxel_size_m
        One point is kept for each voxel of this size.
    """
    o3d = import_open3d()
    fused = o3d.geometry.PointCloud()
    for index, T in zip(frame_indices, T_map_camera, strict=True):
        frame = dataset.frame(index)
        depth_m = frame.depth_m(STRIDE)
        depth_m[depth_m > MAX_RANGE_M] = 0.0
        points_camera = back_project(depth_m, frame.intrinsics, STRIDE)
        cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(se3.transform(T, points_camera)))
        color = dataset.color(index)
        if color is not None:
            rgb = color[::STRIDE, ::STRIDE][depth_m > 0.0] / 255.0
            cloud.colors = o3d.utility.Vector3dVector(rgb.astype(np.float64))
        fused += cloud.voxel_down_sample(voxel_size_m)
    if fused.is_empty():
        path.write_text(EMPTY, encoding="ascii", newline="\n")
        return 0
    fused = fused.voxel_down_sample(voxel_size_m)
    if not o3d.io.write_point_cloud(str(path), fused):
        raise OSError(f"cannot write {path}")
    return len(fused.points)
