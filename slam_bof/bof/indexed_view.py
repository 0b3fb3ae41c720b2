"""What an index holds of one view: its packed contours, and the cells to look each up in.

No more is ever needed of an older view, so a map keeps it as well and need not describe its views
again.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from typing import Self

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof.constellation import ConstellationParams, PlacedBofs
from slam_bof.bof.constellation_correspondences import weights
from slam_bof.bof.constellation_packing import PACKED, pack_constellation
from slam_bof.bof.motion_votes import phases
from slam_bof.bof.shape_cells import contour_keys
from slam_bof.types import SensorParams

__all__ = ["CONTOUR_BYTES", "IndexedView", "describer_id", "index_view"]

DESCRIBER_VERSION = 1
"""Version of the description, which rises with each change of the contours of a depth image."""
CONTOUR = np.dtype([("row", PACKED), ("key", "<i4"), ("phases", np.uint8, 2)])
CONTOUR_BYTES = CONTOUR.itemsize


@dataclass(frozen=True, slots=True, eq=False)
class IndexedView:
    """The C contours of a view: packed rows (C,), keys (C,) and phases (C, 2) of two harmonics.

    ``total`` is the weight of all of them.
    """

    rows: NDArray[np.void]
    keys: NDArray[np.int32]
    phases: NDArray[np.uint8]
    total: float

    def __len__(self) -> int:
        """Return the number of contours."""
        return len(self.rows)

    def tobytes(self) -> bytes:
        """Return the contours, without ``total``, in ``CONTOUR_BYTES`` each."""
        contours = np.empty(len(self), CONTOUR)
        contours["row"], contours["key"], contours["phases"] = self.rows, self.keys, self.phases
        return contours.tobytes()

    @classmethod
    def of_bytes(cls, contours: bytes, total: float) -> Self:
        """Return a view from ``tobytes`` and its total."""
        found = np.frombuffer(contours, CONTOUR)
        return cls(found["row"], found["key"], found["phases"], total)


def index_view(bofs: PlacedBofs) -> IndexedView:
    """Return what an index holds of a view's contours."""
    rows = pack_constellation(bofs)
    total = float(weights(bofs).sum())
    return IndexedView(rows, contour_keys(bofs, rows["mean"]), phases(bofs), total)


def describer_id(params: ConstellationParams, sensor: SensorParams) -> str:
    """Return an identifier of the parameters by which contours are found: 16 digits of a hash."""
    means = json.dumps([DESCRIBER_VERSION, params.model_dump(), sensor.model_dump()])
    return hashlib.sha256(means.encode()).hexdigest()[:16]
