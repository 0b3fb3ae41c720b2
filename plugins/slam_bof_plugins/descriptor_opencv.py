"""SIFT (Lowe 2004) and ORB (Rublee et al. 2011) of the grey image, by OpenCV."""

from __future__ import annotations

from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.types import DepthFrame, Params

__all__ = ["OrbDescriptor", "OrbParams", "SiftDescriptor", "SiftParams"]


class SiftParams(Params):
    """OpenCV's own defaults."""

    n_features: int = Field(
        0, ge=0, description="Largest number of features; the strongest are kept. 0 keeps all."
    )


class OrbParams(Params):
    """OpenCV's own defaults."""

    n_features: int = Field(
        500, gt=0, description="Largest number of features; the strongest are kept."
    )


class SiftDescriptor:
    """128 gradient sums a key point."""

    Params = SiftParams
    needs_gray: ClassVar[bool] = True
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "bag"

    def __init__(self, params: SiftParams) -> None:
        self._sift = cv2.SIFT.create(nfeatures=params.n_features)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the descriptors, (M, 128)."""
        return _described(self._sift, gray, (128, np.float32))


class OrbDescriptor:
    """256 comparisons of pixels a key point."""

    Params = OrbParams
    needs_gray: ClassVar[bool] = True
    is_binary: ClassVar[bool] = True
    comparison: ClassVar[str] = "bag"

    def __init__(self, params: OrbParams) -> None:
        self._orb = cv2.ORB.create(nfeatures=params.n_features)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        """Return the descriptors, (M, 32): 256 bits each."""
        return _described(self._orb, gray, (32, np.uint8))


def _described(
    detector: Any, gray: NDArray[np.uint8] | None, shape: tuple[int, type]
) -> NDArray[Any]:
    if gray is None:
        raise ValueError("a grey image is needed, got none")
    _, found = detector.detectAndCompute(gray, None)
    n_values, dtype = shape
    return np.empty((0, n_values), dtype) if found is None else np.asarray(found)
