"""GIST (Oliva and Torralba, IJCV 2001) of the grey image, or of the depth image.

The energy of Gabor filters at several scales and orientations, averaged over the cells of a
coarse grid, after local contrast is evened out. Filters as in the authors' LMgist.
"""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.fft import fft2, ifft2
from scipy.ndimage import distance_transform_edt

from slam_bof.types import DepthFrame, Params

__all__ = ["DepthGistDescriptor", "GistDescriptor", "GistParams"]

PAD_PX = 16
"""Mirrored around the image, which the Fourier transform takes to be periodic."""


class GistParams(Params):
    """As in the authors' code, for images half as large."""

    side_px: int = Field(128, gt=0, description="the image is made so large, and square")
    n_orientations: tuple[int, ...] = Field((8, 8, 8, 8), description="of each scale, finest first")
    n_blocks: int = Field(4, gt=0, description="cells of the grid, each way")
    contrast_cycles: float = Field(4.0, gt=0, description="an image; lower frequencies go")


class GistDescriptor:
    """GIST of the grey image."""

    Params = GistParams
    needs_gray: ClassVar[bool] = True
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "l1"

    def __init__(self, params: GistParams) -> None:
        self._params = params
        side = params.side_px + 2 * PAD_PX
        fx, fy = np.meshgrid(*2 * [np.fft.fftfreq(side) * side])
        self._filters = _gabor_filters(fx, fy, params.n_orientations, side)
        width = params.contrast_cycles / np.sqrt(np.log(2.0))
        self._blur = np.exp(-(fx**2 + fy**2) / width**2)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the energies, (1, filters * blocks)."""
        if gray is None:
            raise ValueError("a grey image is needed, got none")
        return self._gist(gray.astype(np.float64))

    def _gist(self, image: NDArray[np.float64]) -> NDArray[np.float32]:
        p = self._params
        small = cv2.resize(image, (p.side_px, p.side_px), interpolation=cv2.INTER_AREA)
        padded = np.pad(np.asarray(small, np.float64), PAD_PX, mode="symmetric")
        spectrum = fft2(self._even_out(padded))
        energy = np.abs(ifft2(spectrum * self._filters))[:, PAD_PX:-PAD_PX, PAD_PX:-PAD_PX]
        block = p.side_px // p.n_blocks
        cells = energy[:, : block * p.n_blocks, : block * p.n_blocks]
        cells = cells.reshape(len(energy), p.n_blocks, block, p.n_blocks, block)
        return np.asarray(cells.mean(axis=(2, 4)), np.float32).reshape(1, -1)

    def _even_out(self, image: NDArray[np.float64]) -> NDArray[np.float64]:
        """Remove what is brighter over large areas, and divide by the local contrast."""
        logarithm = np.log1p(image)
        detail = logarithm - ifft2(fft2(logarithm) * self._blur).real
        contrast = np.sqrt(np.abs(ifft2(fft2(detail**2) * self._blur)))
        return np.asarray(detail / (0.2 + contrast))


class DepthGistDescriptor(GistDescriptor):
    """GIST of the depth image, its holes filled with what is nearest to them."""

    needs_gray: ClassVar[bool] = False

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the energies, (1, filters * blocks)."""
        depth_m = frame.depth_m(4 if frame.intrinsics.width >= 4 * self._params.side_px else 1)
        if not depth_m.any():
            return self._gist(np.zeros_like(depth_m, dtype=np.float64))
        nearest = distance_transform_edt(depth_m == 0, return_distances=False, return_indices=True)
        # Greys up to 255 for 8 metres, as the contrast floor is meant for greys.
        return self._gist(depth_m[tuple(nearest)].astype(np.float64) * (255.0 / 8.0))


def _gabor_filters(
    fx: NDArray[np.float64], fy: NDArray[np.float64], n_orientations: tuple[int, ...], side: int
) -> NDArray[np.float64]:
    """Return the transfer functions (F, side, side), all positive frequencies of one direction."""
    radius, angle = np.hypot(fx, fy) / side, np.arctan2(fy, fx)
    filters = []
    for scale, n in enumerate(n_orientations):
        centre = 0.3 / 1.85**scale
        for k in range(n):
            turned = np.angle(np.exp(1j * (angle + np.pi / n * k)))
            across = 16.0 * n**2 / 32.0**2
            filters.append(
                np.exp(-3.5 * (radius / centre - 1.0) ** 2 - 2.0 * np.pi * across * turned**2)
            )
    return np.array(filters)
