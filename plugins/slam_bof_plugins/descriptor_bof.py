"""BOF by the port that other descriptors come by, to be compared with them."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from slam_bof.places import PlaceParams, descriptors
from slam_bof.types import DepthFrame

__all__ = ["BofDescriptor"]


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
