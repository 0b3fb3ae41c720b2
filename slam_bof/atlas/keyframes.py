"""The constellations of the keyframes of a map, to be added to an atlas."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import PlacedBofs, describe_constellation
from slam_bof.core import one_blas_thread
from slam_bof.geometry import GravityTracker, make_view
from slam_bof.maps import load_searched

__all__ = ["DescribedKeyframes", "describe_map"]


class DescribedKeyframes(NamedTuple):
    """Keyframes of a map: ids (V,), their contours, how many each has, and how it is levelled.

    ``R_level_camera`` (V, 3, 3) is that of ``bof.Constellation``.
    """

    ids: NDArray[np.int32]
    bofs: PlacedBofs
    counts: NDArray[np.int64]
    R_level_camera: NDArray[np.float32]


@one_blas_thread()
def describe_map(path: Path) -> DescribedKeyframes:
    """Describe the keyframes of a finished map that images are compared with.

    Raises
    ------
    MapError
        If the map is damaged, has no depth images, or its last run was interrupted.
    """
    found = load_searched(path)
    tracker = GravityTracker(
        found.config.gravity_odom, found.config.loops.recogniser.gravity, never_lost=True
    )
    described = []
    for frame, T_map_camera in zip(found.frames, found.T_map_camera, strict=True):
        frame = frame.with_sensor(found.config.sensor)
        down = tracker.update(make_view(frame).known_normals(), T_map_camera)
        described.append(describe_constellation(frame, down))
    columns = zip(*(constellation.bofs for constellation in described), strict=True)
    return DescribedKeyframes(
        np.array([keyframe.id for keyframe in found.keyframes], np.int32),
        PlacedBofs(*(np.concatenate(column) for column in columns)),
        np.array([len(constellation) for constellation in described]),
        np.array([c.R_level_camera for c in described], np.float32),
    )
