"""Localization of depth images in a saved map, with their scene labels."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np

from slam_bof.core import registry
from slam_bof.errors import DatasetError, MapError
from slam_bof.places import Localization, Localizer
from slam_bof.scenes import Labeller, model as models
from slam_bof.slam import Config, config as configs
from slam_bof.store import MapStore, choose_component, components_of
from slam_bof.types import (
    Array,
    DepthFrame,
    Intrinsics,
    Keyframe,
    SavedConstellation,
    Scene,
    SensorParams,
)

__all__ = ["LocalizedFrame", "MapLocalizer", "SearchedMap", "load_searched"]


@dataclass(frozen=True, slots=True, eq=False)
class LocalizedFrame:
    """A depth image localized in a map.

    ``localization`` has the pose, or the reason why it is unknown. ``scene`` is the label of the
    image itself, None without a scene classifier. ``keyframe`` is the one that matches, and
    ``room`` its smoothed label.
    """

    localization: Localization
    scene: Scene | None
    keyframe: Keyframe | None
    room: str | None


class SearchedMap(NamedTuple):
    """What images are compared with in a map: keyframes, their depth images and poses (K, 4, 4).

    ``constellations`` are None where none was saved. ``config`` is that of the last session,
    ``model_hash`` the model of the map, and ``component`` that of the keyframes.
    """

    config: Config
    model_hash: str | None
    camera: Intrinsics
    keyframes: list[Keyframe]
    frames: list[DepthFrame]
    constellations: list[SavedConstellation | None]
    T_map_camera: Array
    component: int


def load_searched(path: Path, component: int | None = None) -> SearchedMap:
    """Load the keyframes of a finished map that images are compared with.

    Of several components that is one, by default the largest, without culled keyframes.

    Raises
    ------
    MapError
        If the map has no keyframes or no depth images, is damaged, or its last run was
        interrupted.
    """
    with MapStore.open(path) as store, store.snapshot():
        sessions, camera = store.sessions(), store.intrinsics()
        keyframes, T_map_camera = store.keyframes(), store.map_poses()
        if not keyframes:
            raise MapError(f"{path}: found no keyframes, expected at least one")
        if camera is None:
            raise MapError(
                f"{path}: found no depth images, expected some: maps made before version 4 "
                "have none"
            )
        if not np.isfinite(T_map_camera).all():
            raise MapError(
                f"{path}: found an interrupted run of {sessions[-1].sequence}, "
                f"expected a finished one: resume it, or slam-bof map finish {path}"
            )
        config = configs.parse_saved(sessions[-1].config, f"{path}: session {sessions[-1].id}")
        anchors = store.anchors()
        inside = choose_component(store, component)
        searched = np.flatnonzero(inside & (anchors == np.arange(len(anchors))))
        frames = []
        for k in searched.tolist():
            frame = store.view(k)
            if frame is None:
                raise MapError(f"{path}: found no depth image of keyframe {k}, expected one")
            frames.append(frame)
        return SearchedMap(
            config,
            store.parameters().get("model"),
            camera,
            [keyframes[k] for k in searched],
            frames,
            [store.constellation(k) for k in searched.tolist()],
            T_map_camera[searched],
            int(components_of(store)[inside][0]),
        )


class MapLocalizer:
    """Localizes depth images in a saved map and labels them with the map's model.

    Of a map with several components, which no loop connects, one is used, by default the largest.
    Culled keyframes are not compared with.

    Attributes
    ----------
    intrinsics
        The camera of the map.
    component
        The component of the pose graph that poses refer to.

    Examples
    --------
    >>> localizer = MapLocalizer.open("runs/latest/map.db")  # doctest: +SKIP
    >>> answer = localizer.localize(frame)  # doctest: +SKIP
    >>> print(answer.localization.T_map_camera, answer.room)  # doctest: +SKIP
    """

    def __init__(
        self,
        localizer: Localizer,
        keyframes: dict[int, Keyframe],
        labeller: Labeller | None,
        intrinsics: Intrinsics,
        sensor: SensorParams,
        component: int,
    ) -> None:
        self.intrinsics = intrinsics
        self.component = component
        self._sensor = sensor
        self._localizer = localizer
        self._keyframes = keyframes
        self._labeller = labeller

    @classmethod
    def open(cls, path: Path | str, *, component: int | None = None) -> Self:
        """Load a finished map: a component of it, by default the largest.

        Raises
        ------
        MapError
            If the map has no keyframes, no depth images or no such component, is damaged, or its
            last run was interrupted.
        ModelError
            If the model that the map was made with is missing.
        """
        found = load_searched(Path(path), component)
        config = found.config
        model = models.resolve(models.name_by_hash(config.model, found.model_hash))
        localizer = Localizer(
            registry.build("verifiers", config.verifier.name, config.verifier.options),
            recogniser_params=config.loops.recogniser,
            gravity_odom=config.gravity_odom,
            sensor=config.sensor,
            seed=config.seed,
        )
        own = {int(keyframe.id): keyframe for keyframe in found.keyframes}
        columns = (own, found.frames, found.T_map_camera, found.constellations)
        for id_, frame, T_map_camera, saved in zip(*columns, strict=True):
            localizer.add(frame, T_map_camera, name=id_, constellation=saved)
        labeller = model.labeller(config.labels.by)
        return cls(localizer, own, labeller, found.camera, config.sensor, found.component)

    def __len__(self) -> int:
        """Return the number of keyframes that images are compared with."""
        return len(self._keyframes)

    def localize(self, frame: DepthFrame) -> LocalizedFrame:
        """Localize a single frame and label it.

        Raises
        ------
        DatasetError
            If the frame's camera is not the map's.
        """
        if not frame.intrinsics.is_close(self.intrinsics):
            raise DatasetError(
                f"found a frame of {frame.intrinsics}, expected the map's camera, {self.intrinsics}"
            )
        frame = replace(frame, intrinsics=self.intrinsics).corrected(self._sensor)
        localization = self._localizer.localize(frame)
        scene = None if self._labeller is None else self._labeller.label(frame)
        if localization.keyframe_id is None:
            return LocalizedFrame(localization, scene, keyframe=None, room=None)
        keyframe = self._keyframes[localization.keyframe_id]
        label = keyframe.smoothed or keyframe.scene
        room = None if label is None else label.label
        return LocalizedFrame(localization, scene, keyframe=keyframe, room=room)
