"""What a frame shows: contours, a bag of visual words, and a scene label."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slam_bof.types.poses import Array

__all__ = ["Bag", "Contours", "SavedConstellation", "Scene"]


@dataclass(frozen=True, slots=True, eq=False)
class Contours:
    """The closed contours of one frame's layer images.

    ``points_px[i]`` is an (M_i, 2) int32 array with the (x, y) corners of a closed polygon in
    order. It was found in layer ``layer[i]``; ``layer`` is (C,) int32.
    """

    points_px: tuple[NDArray[np.int32], ...]
    layer: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of contours."""
        return len(self.points_px)


@dataclass(frozen=True, slots=True, eq=False)
class Bag:
    """A sparse bag of visual words: sorted distinct words and their L1-normalised weights.

    ``words`` is (W,) int32. ``weights`` is (W,) float32, positive, and sums to 1. Both are empty
    for a frame without features.
    """

    words: NDArray[np.int32]
    weights: NDArray[np.float32]


@dataclass(frozen=True, slots=True, eq=False)
class SavedConstellation:
    """The BOF constellation of a keyframe as a map keeps it, so that it is not described again.

    ``gravity_camera`` (3,) is the direction down in the camera frame that the keyframe was levelled
    by. ``describer`` names what found the contours, ``bof.describer_id``. ``contours`` and
    ``weight`` are those of ``bof.IndexedView``.
    """

    gravity_camera: Array
    describer: str
    contours: bytes
    weight: float


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A scene label, and the probabilities (C,) of all classes in the order of ``classes``."""

    label: str
    probability: float
    classes: tuple[str, ...]
    probabilities: Array
