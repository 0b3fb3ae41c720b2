"""A saved map asked where depth images were taken, and what scene they show."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from slam_bof.core import registry
from slam_bof.errors import DatasetError, MapError
from slam_bof.places import Localization, Localizer
from slam_bof.scenes import Labeller, model as models
from slam_bof.slam import config as configs
from slam_bof.store import MapStore, parts_of
from slam_bof.types import DepthFrame, Intrinsics, Keyframe, Scene

__all__ = ["Located", "MapLocalizer"]


@dataclass(frozen=True, slots=True, eq=False)
class Located:
    """What a map says of a depth image.

    ``found`` has the pose, or why it is not known. ``scene`` is what the image itself shows, None
    without a scene classifier; ``room`` the smoothed label of the keyframe that matches.
    """

    found: Localization
    scene: Scene | None
    keyframe: Keyframe | None
    room: str | None


class MapLocalizer:
    """A map's keyframes, and the model that labelled them.

    Of a map in several parts, which no loop has joined, the largest is asked.

    Examples
    --------
    >>> places = MapLocalizer.open("runs/latest/map.db")  # doctest: +SKIP
    >>> located = places.localize(frame)  # doctest: +SKIP
    >>> print(located.found.T_map_camera, located.room)  # doctest: +SKIP
    """

    def __init__(
        self,
        localizer: Localizer,
        keyframes: list[Keyframe],
        labeller: Labeller | None,
        intrinsics: Intrinsics,
    ) -> None:
        self.intrinsics = intrinsics
        self._localizer = localizer
        self._keyframes = keyframes
        self._labeller = labeller

    @classmethod
    def open(cls, path: Path | str) -> Self:
        """Load a finished map.

        Raises
        ------
        MapError
            If it has no keyframes, an interrupted run, no depth images, or damage.
        ModelError
            If the model that it was made with is not there.
        """
        path = Path(path)
        with MapStore.open(path) as store:
            sessions, camera = store.sessions(), store.intrinsics()
            keyframes, T_map_camera = store.keyframes(), store.map_poses()
            if not keyframes:
                raise MapError(f"{path}: found no keyframes, expected some to compare with")
            if camera is None:
                raise MapError(
                    f"{path}: found no depth images, expected some: maps made before version 4 "
                    "have none"
                )
            if not np.isfinite(T_map_camera).all():
                raise MapError(
                    f"{path}: found that the run of {sessions[-1].sequence} was interrupted, "
                    "expected a finished one: resume it first"
                )
            config = configs.parse(sessions[-1].config, f"{path}: session {sessions[-1].id}")
            model = (
                models.load_default() if config.model == "default" else models.load(config.model)
            )
            parts = parts_of(store)
            largest = np.flatnonzero(parts == np.bincount(parts).argmax())
            localizer = Localizer(
                registry.build("verifiers", config.verifier.name, config.verifier.options),
                recogniser_params=config.loops.recogniser,
                gravity_odom=config.gravity_odom,
                seed=config.seed,
            )
            for k in largest:
                frame = store.view(int(k))
                if frame is None:
                    raise MapError(f"{path}: found no depth image of keyframe {k}, expected one")
                localizer.add(frame, T_map_camera[k])
        own = [keyframes[k] for k in largest]
        return cls(localizer, own, model.labeller(), camera)

    def __len__(self) -> int:
        """Return the number of keyframes asked."""
        return len(self._keyframes)

    def localize(self, frame: DepthFrame) -> Located:
        """Return where a frame was taken, by itself, and what it shows.

        Raises
        ------
        DatasetError
            If it is of another camera than the map.
        """
        if frame.intrinsics != self.intrinsics:
            raise DatasetError(
                f"found a frame of {frame.intrinsics}, expected one of the map's camera: "
                f"{self.intrinsics}"
            )
        found = self._localizer.localize(frame)
        scene = None
        if self._labeller is not None:
            scene = self._labeller.label(frame)
        if found.keyframe_id is None:
            return Located(found, scene, None, None)
        keyframe = self._keyframes[found.keyframe_id]
        label = keyframe.smoothed or keyframe.scene
        return Located(found, scene, keyframe, None if label is None else label.label)
