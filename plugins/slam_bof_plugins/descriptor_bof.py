"""BOF by the port that other descriptors come by, to be compared with them."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof import BofParams, PlaceParams, descriptors, layer_rows
from slam_bof.types import DepthFrame

__all__ = ["BofDescriptor", "LayerBofDescriptor", "LayerBofParams"]


class BofDescriptor:
    """The descriptors of all contours of a frame's layers."""

    Params = PlaceParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "bag"

    def __init__(self, params: PlaceParams) -> None:
        self._params = params

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the BOF descriptors, (C, n_values)."""
        return descriptors(frame, self._params)


class LayerBofParams(PlaceParams):
    """Parameters like those of ``bof``, but contours are sampled coarsely and by angle."""

    bof: BofParams = Field(default=BofParams(n_points=36, sampling="angle"))


class LayerBofDescriptor:
    """The descriptors of each layer's largest contour in one row, for a neural network."""

    Params = LayerBofParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = False
    comparison: ClassVar[str] = "l1"

    def __init__(self, params: LayerBofParams) -> None:
        self._params = params

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.float32]:
        """Return the rows of all layers side by side, (1, n_images * n_values)."""
        return layer_rows(frame, self._params)
