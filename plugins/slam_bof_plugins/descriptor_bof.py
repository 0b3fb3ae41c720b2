"""BOF as descriptor plug-ins, to compare it with other descriptors."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from slam_bof.bof import BofParams, PlaceParams, descriptors, layer_rows
from slam_bof.types import DepthFrame

__all__ = [
    "BofDescriptor",
    "BofFernDescriptor",
    "BofFernParams",
    "LayerBofDescriptor",
    "LayerBofParams",
]


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


class BofFernParams(PlaceParams):
    """Parameters like those of ``bof``, and the seed of the thresholds."""

    seed: int = Field(0, ge=0, description="Seed of the thresholds.")


class BofFernDescriptor:
    """A binary code for each BOF: which of its radii exceed a threshold of their own.

    The paper proposes it (section 4.5), after the ferns of Glocker et al.: the thresholds, one for
    each of the 180 radii, are drawn uniformly.
    """

    Params = BofFernParams
    needs_gray: ClassVar[bool] = False
    is_binary: ClassVar[bool] = True
    comparison: ClassVar[str] = "hamming"

    def __init__(self, params: BofFernParams) -> None:
        self._params = params
        self._thresholds = np.random.default_rng(params.seed).uniform(size=params.bof.n_values)

    def describe(self, frame: DepthFrame, gray: NDArray[np.uint8] | None) -> NDArray[np.uint8]:
        """Return the codes, (C, n_values / 8) packed bits."""
        return np.packbits(descriptors(frame, self._params) > self._thresholds, axis=1)


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
