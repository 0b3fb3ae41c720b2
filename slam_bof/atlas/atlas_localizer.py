"""Localisation in an atlas: the index proposes maps, and each map's own localizer decides."""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from slam_bof.atlas.atlas import Atlas, AtlasMatch
from slam_bof.atlas.manifest import AtlasMap
from slam_bof.bof import Constellation, describe_constellation
from slam_bof.core import one_blas_thread
from slam_bof.errors import SlamBofError
from slam_bof.geometry import GravityTracker, PointParams, make_view, points_camera, render
from slam_bof.maps import LocalizedFrame, MapLocalizer
from slam_bof.types import DepthFrame, Intrinsics

EVERY_POINT = PointParams(stride=1)

__all__ = ["AtlasLocalization", "AtlasLocalizer"]


@dataclass(frozen=True, slots=True, eq=False)
class AtlasLocalization:
    """Where a depth image was taken, or the reason why that is unknown.

    ``map`` and ``located`` (pose, keyframe, room in that map) are None if it is unknown.
    """

    map: AtlasMap | None = None
    located: LocalizedFrame | None = None
    reason: str = ""


class AtlasLocalizer:
    """Finds the map, the keyframe and the pose of depth images, or says that they are not known.

    The maps of the keyframes that agree best are asked for a pose, each by its own ``MapLocalizer``
    with all its checks. If several know one, the answer is unknown: the rooms may be identical.
    A map is loaded when it is first asked, and the last ``n_loaded`` stay in memory.

    Parameters
    ----------
    atlas
        The atlas.
    n_maps
        Number of maps that are asked, best first.
    n_loaded
        Number of maps that stay loaded.

    Examples
    --------
    >>> robot = AtlasLocalizer(Atlas.open("fleet.atlas"))  # doctest: +SKIP
    >>> answer = robot.localize(frame)  # doctest: +SKIP
    >>> print(answer.map.path if answer.map else answer.reason)  # doctest: +SKIP
    """

    def __init__(self, atlas: Atlas, *, n_maps: int = 3, n_loaded: int = 8) -> None:
        self.atlas, self._n_maps, self._n_loaded = atlas, n_maps, n_loaded
        self._loaded: OrderedDict[str, MapLocalizer] = OrderedDict()

    @one_blas_thread()
    def describe(self, frame: DepthFrame, gravity_camera: ArrayLike | None = None) -> Constellation:
        """Describe a depth image as the keyframes of the atlas are."""
        if gravity_camera is None:
            # The mean tilt of all keyframes is the best initial guess.
            tracker = GravityTracker(self.atlas.down, never_lost=True)
            gravity_camera = tracker.update(make_view(frame).known_normals(), np.eye(4))
        return describe_constellation(frame, gravity_camera)

    def propose(
        self, frame: DepthFrame, n: int, *, gravity_camera: ArrayLike | None = None
    ) -> list[AtlasMatch]:
        """Return the best match (at most ``n``) of each map whose keyframes agree with a frame."""
        best: dict[int, AtlasMatch] = {}
        for match in self.atlas.search(self.describe(frame, gravity_camera), len(self.atlas)):
            best.setdefault(match.map.id, match)
        return list(best.values())[:n]

    def localize(
        self, frame: DepthFrame, *, gravity_camera: ArrayLike | None = None
    ) -> AtlasLocalization:
        """Localize a depth image of any camera.

        Parameters
        ----------
        frame
            The depth image. For a map of another camera it is rendered as that would see it.
        gravity_camera
            (3,) direction of gravity in the camera frame, such as that of an inertial sensor. By
            default it is estimated from the frame, which requires that the tilt of the camera is
            within about 40 degrees of that of the keyframes.
        """
        answers: list[tuple[AtlasMap, LocalizedFrame]] = []
        reason = "no keyframe of the atlas matches"
        for number, match in enumerate(
            self.propose(frame, self._n_maps, gravity_camera=gravity_camera)
        ):
            try:
                localizer = self._load(match.map)
            except SlamBofError as error:
                why = str(error)
            else:
                located = localizer.localize(_as_seen_by(localizer.intrinsics, frame))
                if located.localization.is_known:
                    answers.append((match.map, located))
                why = f"{match.map.path}: {located.localization.reason}"
            reason = reason if number else why
        if len(answers) > 1:
            (a, _), (b, _) = answers[:2]
            return AtlasLocalization(
                reason=f"{len(answers)} maps match the image, such as {a.path} and {b.path}"
            )
        return AtlasLocalization(*answers[0]) if answers else AtlasLocalization(reason=reason)

    def _load(self, entry: AtlasMap) -> MapLocalizer:
        """Return the localizer of a map, loaded if need be."""
        if entry.path not in self._loaded:
            self._loaded[entry.path] = MapLocalizer.open(Path(entry.path))
        self._loaded.move_to_end(entry.path)
        while len(self._loaded) > self._n_loaded:
            self._loaded.popitem(last=False)
        return self._loaded[entry.path]


def _as_seen_by(camera: Intrinsics, frame: DepthFrame) -> DepthFrame:
    """Return a frame as another camera in its place would measure it."""
    if frame.intrinsics.is_close(camera):
        return frame
    return replace(
        frame, depth=render(points_camera(frame, EVERY_POINT), camera), intrinsics=camera
    )
