"""What a finished map says of its scenes: a label for each keyframe, and rooms."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.scenes.hmm_filter import SceneFilterParams
from slam_bof.scenes.hmm_smoother import smooth
from slam_bof.scenes.room_segmentation import Region, RegionParams, find_regions
from slam_bof.types import Array, Keyframe, Scene

__all__ = ["label_map"]


def label_map(
    keyframes: Sequence[Keyframe],
    T_map_camera: Array,
    labels: SceneFilterParams | None = None,
    regions: RegionParams | None = None,
    *,
    parts: ArrayLike | None = None,
) -> tuple[list[Scene | None], list[Region]]:
    """Smooth the labels of keyframes over the whole trajectory, and find the rooms.

    Parameters
    ----------
    keyframes, T_map_camera
        K keyframes in the order they came, and their poses (K, 4, 4).
    labels, regions
        Parameters of either.
    parts
        (K,) the part of the map each is in, by default all in one.

    Returns
    -------
    scenes : list of Scene or None
        (K,) the smoothed labels; None for a keyframe that had none.
    regions : list of Region
        The rooms.
    """
    labels, regions = labels or SceneFilterParams(), regions or RegionParams()
    own = [(k, keyframe, keyframe.scene) for k, keyframe in enumerate(keyframes) if keyframe.scene]
    T_map_camera = np.reshape(T_map_camera, (-1, 4, 4))
    positions_m, at = T_map_camera[:, :3, 3], [k for k, *_ in own]
    found = smooth(
        [scene for *_, scene in own],
        [keyframe.stamp_s for _, keyframe, _ in own],
        positions_m[at],
        labels,
        axes=T_map_camera[at, :3, 2],
        parts=None if parts is None else np.asarray(parts)[at],
        segments=[keyframe.segment for _, keyframe, _ in own],
        sessions=[keyframe.session for _, keyframe, _ in own],
    )
    scenes: list[Scene | None] = [None] * len(keyframes)
    for k, scene in zip(at, found, strict=True):
        scenes[k] = scene
    return scenes, find_regions(scenes, positions_m, regions, parts=parts)
