"""How uncertain the poses of a saved map are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slam_bof.slam import MapUncertainty
from slam_bof.store import MapStore, components_of
from slam_bof.types import Array

__all__ = ["pose_covariances"]


def pose_covariances(store: MapStore) -> Array:
    """Return the covariance (K, 6, 6) of each keyframe of a map; see ``MapUncertainty``.

    Rotation comes first, along the axes of the camera, in rad^2 and m^2, relative to the first
    keyframe of its component. NaN where the map has no optimised pose.
    """
    keyframes = [
        keyframe
        if keyframe.T_odom_raw is not None
        else replace(keyframe, T_odom_raw=keyframe.T_odom_camera)
        for keyframe in store.keyframes()
    ]
    known = MapUncertainty.of_map(keyframes, store.loops())
    return known.covariances(np.asarray(components_of(store), np.int64), store.map_poses())
