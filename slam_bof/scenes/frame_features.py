"""The levelled features of a frame: what levelled classifiers and set transformers label it by."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from slam_bof.scenes.contour_tokens import contour_tokens
from slam_bof.scenes.furniture_network import FurnitureNetwork
from slam_bof.scenes.height_profile import measure_profile
from slam_bof.scenes.levelled_cloud import LevelledCloud, levelled_cloud
from slam_bof.scenes.shape_words import N_SHAPE_VALUES, shape_descriptors
from slam_bof.types import Array, DepthFrame

__all__ = ["LevelledFeatures", "levelled_features"]


@dataclass(frozen=True, slots=True, eq=False)
class LevelledFeatures:
    """Features of one frame.

    ``profile`` (N_PROFILE_VALUES,) is the height profile, ``shapes`` (C, N_SHAPE_VALUES) has a
    descriptor of each contour. ``otherwise`` are the features if the floor is where it may be
    instead (``LevelledCloud.possible_height_m``). ``tokens`` (C, N_TOKEN_VALUES) are for a
    classifier of constellations; None where there is none. ``furniture`` (n_values,) is what a
    ``FurnitureNetwork`` sees, for classifiers that have one.
    """

    profile: NDArray[np.float32]
    shapes: NDArray[np.float32]
    otherwise: LevelledFeatures | None = None
    tokens: NDArray[np.float32] | None = None
    furniture: NDArray[np.float32] | None = None


def levelled_features(
    frame: DepthFrame,
    *,
    gravity_camera: Array | None = None,
    with_shapes: bool = False,
    with_tokens: bool = False,
    furniture: FurnitureNetwork | None = None,
) -> LevelledFeatures:
    """Return the features of a frame; other parameters are those of ``levelled_cloud``.

    Descriptors of shapes, for models that have words of them, cost more than all else.
    ``furniture`` is the network of the classifier that the features are for, if it has one.
    """
    cloud = levelled_cloud(frame, gravity_camera=gravity_camera)

    def describe(cloud: LevelledCloud) -> LevelledFeatures:
        none = np.empty((0, N_SHAPE_VALUES), np.float32)
        return LevelledFeatures(
            measure_profile(cloud),
            shape_descriptors(cloud) if with_shapes else none,
            furniture=None if furniture is None else furniture.describe(cloud),
        )

    otherwise = None
    if cloud.possible_height_m is not None:
        near = replace(cloud, camera_height_m=cloud.possible_height_m, floor_seen=True)
        otherwise = describe(near)
    tokens = contour_tokens(cloud) if with_tokens else None
    return replace(describe(cloud), otherwise=otherwise, tokens=tokens)
