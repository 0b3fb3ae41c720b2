"""GIST (Oliva and Torralba 2001): how much structure of each scale and direction lies where.

After the description that its authors give of it: even out brightness and contrast, filter with
Gabor functions in the Fourier domain, average the magnitudes over blocks.
"""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy import fft
from scipy.ndimage import distance_transform_edt

from slam_bof.types import DepthFrame, Params
from slam_bof_plugins.descriptor_depth import ThumbnailDescriptor, ThumbnailParams

__all__ = ["DepthGistDescriptor", "GistDescriptor", "GistParams"]

Image = NDArray[np.float32]

HIGHEST_FREQUENCY = 0.3
"""Centre frequency of the finest scale, in cycles a pixel."""
SCALE_STEP = 1.85


class GistParams(Params):
    """Parameters of the authors' prefilter and filter bank, for images of 128 pixels."""

    n_blocks: int = Field(4, gt=0, description="Number of blocks along either side of the image.")
    block_px: int = Field(
        32, gt=0, description="Side of a block in pixels; the image is resized to fit."
    )
    n_scales: int = Field(4, gt=0, description="Number of scales of the filter bank.")
    n_orientations: int = Field(8, gt=0, description="Number of orientations at each scale.")
    smooth_cycles: float = Field(
        4.0,
        gt=0,
        description="Cut-off of the prefilter in cycles an image: slower changes of brightness "
        "and contrast are removed.",
    )
    min_contrast: float = Field(
        0.2,
        gt=0,
        description="Contrast above which the prefilter normalises it, in units of log "
        "brightness, or in metres for depth.",
    )


class GistDescriptor:
    """GIST of the grey image."""

    Params = GistParams
    needs_gray: ClassVar[bool] = True
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "l1"

    def __init__(self, params: GistParams) -> None:
        self._gist = _Gist(params)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the GIST, (1, scales * orientations * blocks ** 2)."""
        if gray is None:
            raise ValueError("a grey image is needed, got none")
        size = (self._gist.size_px, self._gist.size_px)
        small = cv2.resize(gray, size, interpolation=cv2.INTER_AREA)
        return self._gist.describe(np.log1p(small.astype(np.float32)))


class DepthGistDescriptor:
    """GIST of the depth image in metres, where holes are as deep as the nearest known pixel."""

    Params = GistParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "l1"

    def __init__(self, params: GistParams) -> None:
        self._gist = _Gist(params)
        size_px = self._gist.size_px
        self._thumbnail = ThumbnailDescriptor(ThumbnailParams(width_px=size_px, height_px=size_px))

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the GIST, (1, scales * orientations * blocks ** 2)."""
        size_px = self._gist.size_px
        depth_m = self._thumbnail.describe(frame, gray).reshape(size_px, size_px)
        return self._gist.describe(_fill_holes(depth_m))


class _Gist:
    """The filters, made once."""

    def __init__(self, params: GistParams) -> None:
        self._params = params
        self.size_px = params.n_blocks * params.block_px
        self._margin_px = self.size_px // 8
        cycles = fft.fftfreq(self.size_px + 2 * self._margin_px)  # a pixel
        x, y = np.meshgrid(cycles, cycles)
        self._smooth = _smooth(x, y, params.smooth_cycles / len(cycles))
        self._bank = _bank(x, y, params)

    def describe(self, image: Image) -> NDArray[np.float32]:
        """Return the mean magnitudes (1, D) of an image (size_px, size_px)."""
        n_blocks, block_px = self._params.n_blocks, self._params.block_px
        margin_px = self._margin_px
        padded = self._even_out(np.pad(image, margin_px, mode="symmetric"))
        magnitudes = np.abs(fft.ifft2(fft.fft2(padded) * self._bank))
        inside = slice(margin_px, margin_px + self.size_px)
        blocks = magnitudes[:, inside, inside].reshape(-1, n_blocks, block_px, n_blocks, block_px)
        return np.asarray(blocks.mean(axis=(2, 4)).reshape(1, -1), np.float32)

    def _even_out(self, image: Image) -> Image:
        details = image - self._blur(image)
        contrast = np.sqrt(np.abs(self._blur(details**2)))
        return np.asarray(details / (self._params.min_contrast + contrast))

    def _blur(self, image: Image) -> Image:
        return np.asarray(fft.ifft2(fft.fft2(image) * self._smooth).real)


def _smooth(x: NDArray[np.float64], y: NDArray[np.float64], half: float) -> Image:
    """Return a Gaussian low pass over frequencies that passes half of ``half``."""
    return np.asarray(np.exp2(-(x**2 + y**2) / half**2), np.float32)


def _bank(x: NDArray[np.float64], y: NDArray[np.float64], params: GistParams) -> Image:
    """Return the filters over frequencies (N, N), (scales * orientations, N, N).

    Gaussians around their frequency and direction, so that one passes only half of the plane and
    what comes out is complex: its magnitude is the structure's, wherever its edges lie.
    """
    radius, angle = np.hypot(x, y), np.arctan2(y, x)
    filters = []
    for scale in range(params.n_scales):
        center = HIGHEST_FREQUENCY / SCALE_STEP**scale
        along = np.exp(-3.5 * (radius / center - 1) ** 2)
        for direction in np.pi * np.arange(params.n_orientations) / params.n_orientations:
            off = (angle - direction + np.pi) % (2 * np.pi) - np.pi
            across = np.exp(-2 * np.pi * (off * params.n_orientations / 8) ** 2)
            filters.append(along * across)
    return np.asarray(filters, np.float32)


def _fill_holes(depth_m: Image) -> Image:
    missing = depth_m == 0
    if missing.all():
        return depth_m
    nearest = distance_transform_edt(missing, return_distances=False, return_indices=True)
    return np.asarray(depth_m[tuple(nearest)])
