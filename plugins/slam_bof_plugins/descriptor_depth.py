"""Descriptors of a whole depth image: a thumbnail, random ferns, an occupancy grid."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.ndimage import gaussian_filter

from slam_bof.geometry import PointParams, points_camera_f32
from slam_bof.types import DepthFrame, Params

__all__ = ["FernDescriptor", "OccupancyDescriptor", "ThumbnailDescriptor"]


class ThumbnailParams(Params):
    """Size of the thumbnail."""

    width_px: int = Field(32, gt=0, description="Width of the thumbnail in pixels.")
    height_px: int = Field(24, gt=0, description="Height of the thumbnail in pixels.")


class FernParams(Params):
    """Number and image of the binary tests (Glocker et al., TVCG 2015)."""

    n_ferns: int = Field(500, gt=0, description="Number of ferns.")
    n_bits: int = Field(4, gt=0, le=8, description="Number of binary tests of a fern.")
    width_px: int = Field(
        40, gt=0, description="Width in pixels of the blurred image that the tests are made on."
    )
    height_px: int = Field(
        30, gt=0, description="Height in pixels of the blurred image that the tests are made on."
    )
    min_depth_m: float = Field(0.8, gt=0, description="Least threshold of a test, in metres.")
    max_depth_m: float = Field(4.0, gt=0, description="Largest threshold of a test, in metres.")
    seed: int = Field(0, ge=0, description="Seed of the tests.")


class OccupancyParams(Params):
    """The box in front of the camera that is divided into voxels."""

    points: PointParams = PointParams()
    voxel_m: float = Field(0.1, gt=0, description="Side of a voxel in metres.")
    sigma_m: float = Field(
        0.1,
        gt=0,
        description="Standard deviation of the blur in metres, which makes small motions matter "
        "less.",
    )
    half_width_m: float = Field(
        2.0,
        gt=0,
        description="Extent of the box to the left and to the right of the camera, in metres.",
    )
    half_height_m: float = Field(
        1.6, gt=0, description="Extent of the box above and below the camera, in metres."
    )
    near_m: float = Field(
        0.2, ge=0, description="Distance of the front of the box from the camera, in metres."
    )
    far_m: float = Field(
        4.2, gt=0, description="Distance of the back of the box from the camera, in metres."
    )


class ThumbnailDescriptor:
    """The downsampled depth image, 0 where most of it is unknown."""

    Params = ThumbnailParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "l1"

    def __init__(self, params: ThumbnailParams) -> None:
        self._size = (params.width_px, params.height_px)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the thumbnail in metres, (1, width * height)."""
        return _shrink(frame, self._size).reshape(1, -1)


class FernDescriptor:
    """Codes of random ferns, whose tests compare a pixel's depth with a threshold."""

    Params = FernParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "equal"

    def __init__(self, params: FernParams) -> None:
        self._size = (params.width_px, params.height_px)
        random = np.random.default_rng(params.seed)
        shape = (params.n_ferns, params.n_bits)
        self._pixels = random.integers(params.width_px * params.height_px, size=shape)
        self._thresholds_m = random.uniform(params.min_depth_m, params.max_depth_m, shape)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        """Return the ferns' codes, (1, n_ferns)."""
        farther = _shrink(frame, self._size).reshape(-1)[self._pixels] > self._thresholds_m
        return np.packbits(farther, axis=1, bitorder="little").reshape(1, -1)


class OccupancyDescriptor:
    """The blurred occupancy of the voxels that the frame's points lie in."""

    Params = OccupancyParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "cosine"

    def __init__(self, params: OccupancyParams) -> None:
        self._params = params
        half = (params.half_width_m, params.half_height_m)
        self._origin_m = np.array([-half[0], -half[1], params.near_m], np.float32)
        size_m = np.array([2 * half[0], 2 * half[1], params.far_m - params.near_m])
        self._shape = tuple(np.rint(size_m / params.voxel_m).astype(int).tolist())

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the occupancy, (1, voxels)."""
        p = self._params
        points = points_camera_f32(frame, p.points)
        voxels = np.floor((points - self._origin_m) / np.float32(p.voxel_m)).astype(np.intp)
        inside = ((voxels >= 0) & (voxels < self._shape)).all(axis=1)
        occupied = np.zeros(self._shape, np.float32)
        occupied[tuple(voxels[inside].T)] = 1.0
        sigma = p.sigma_m / p.voxel_m
        blurred = gaussian_filter(occupied, sigma, mode="constant", truncate=2.5)
        return np.asarray(blurred, np.float32).reshape(1, -1)


def _shrink(frame: DepthFrame, size: tuple[int, int]) -> NDArray[np.float32]:
    """Return the mean depth of each cell of a coarse grid in metres, 0 where little is known."""
    depth_m = frame.depth_m()
    known = (depth_m > 0).astype(np.float32)
    total = cv2.resize(depth_m, size, interpolation=cv2.INTER_AREA)
    share = cv2.resize(known, size, interpolation=cv2.INTER_AREA)
    return np.where(share > 0.3, total / np.maximum(share, 1e-3), 0.0).astype(np.float32)
