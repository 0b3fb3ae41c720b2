"""The constellations of the keyframes of a map, to be added to an atlas."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from slam_bof.bof import (
    ConstellationIndex,
    ConstellationParams,
    describe_constellation,
    index_view,
)
from slam_bof.core import one_blas_thread
from slam_bof.geometry import GravityTracker, level_frame, make_view
from slam_bof.maps import load_searched
from slam_bof.places import restore_constellation

__all__ = ["DescribedKeyframes", "describe_map"]


@dataclass(frozen=True, slots=True, eq=False)
class DescribedKeyframes:
    """Keyframes of a map: ids (V,), an index of their contours, and how each is levelled.

    ``R_level_camera`` (V, 3, 3) is that of ``bof.Constellation``.
    """

    ids: NDArray[np.int32]
    index: ConstellationIndex
    R_level_camera: NDArray[np.float32]


@one_blas_thread()
def describe_map(path: Path) -> DescribedKeyframes:
    """Return the keyframes of a finished map that images are compared with.

    Those whose constellation the map has saved are not described again.

    Raises
    ------
    MapError
        If the map is damaged, has no depth images, or its last run was interrupted.
    """
    found = load_searched(path)
    params, sensor = ConstellationParams(), found.config.sensor
    tracker = GravityTracker(
        found.config.gravity_odom, found.config.loops.recogniser.gravity, never_lost=True
    )
    index, R_level_camera = ConstellationIndex(), []
    columns = (found.frames, found.T_map_camera, found.constellations)
    for frame, T_map_camera, saved in zip(*columns, strict=True):
        frame = frame.with_sensor(sensor)
        if saved is None:
            down = tracker.update(make_view(frame).known_normals(), T_map_camera)
        else:
            down = saved.gravity_camera
        view = restore_constellation(saved, params, sensor)
        if view is None:
            view = index_view(describe_constellation(frame, down, params).bofs)
        index.add_view(view)
        R_level_camera.append(level_frame(down))
    ids = np.array([keyframe.id for keyframe in found.keyframes], np.int32)
    return DescribedKeyframes(ids, index, np.array(R_level_camera, np.float32))
