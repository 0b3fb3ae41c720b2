"""What the node does with frames: map or localise, in a map that is saved or only read."""

from __future__ import annotations

import logging
import shutil
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from slam_bof.errors import FrameError, MapError
from slam_bof.maps import (
    MapSession,
    OccupancyGrid,
    build_occupancy_grid,
    finish_map,
    with_model_of,
)
from slam_bof.slam import LoopCloser, MapOutline, config as configs
from slam_bof.store import MapStore, replay_keyframes
from slam_bof.types import DepthFrame, Pose, Step
from slam_bof_ros.frames import Cloud, PosedFrame

__all__ = ["Health", "Mapper", "MapperSettings"]

logger = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MapperSettings:
    """What the node's parameters say."""

    map_file: Path
    mode: Literal["mapping", "localization"] = "mapping"
    config: str = "indoor"
    assignments: tuple[str, ...] = ()
    background: bool = True


@dataclass(slots=True)
class Health:
    """How it goes: counts of frames by ``Step.health``, and how long they took."""

    counts: dict[str, int] = field(default_factory=dict)
    last: str = "no frame yet"
    latencies_ms: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def add(self, health: str, latency_s: float) -> None:
        """Count a frame."""
        self.counts[health] = self.counts.get(health, 0) + 1
        self.last = health
        self.latencies_ms = [*self.latencies_ms[-299:], 1e3 * latency_s]

    def values(self) -> dict[str, str]:
        """Return counts and latencies as text, by name."""
        latencies = np.percentile(self.latencies_ms or [np.nan], [50, 99, 100])
        names = ("latency p50 ms", "latency p99 ms", "latency max ms")
        return {
            **{f"frames {name}": str(n) for name, n in sorted(self.counts.items())},
            **{name: f"{value:.1f}" for name, value in zip(names, latencies, strict=True)},
        }


class Mapper:
    """Takes frames with their odometry; has the correction of the odometry, and the map.

    In ``localization`` the saved map is continued in memory and never written: until a loop joins
    the new frames to it, ``is_located`` is False.
    """

    def __init__(self, settings: MapperSettings) -> None:
        self.settings = settings
        self.health = Health()
        self.is_paused = self.is_finished = False
        self._open()

    def _open(self) -> None:
        s = self.settings
        self.step: Step | None = None
        self._chosen: list[PosedFrame] = []
        self._arrived: list[PosedFrame] = []
        self._session: MapSession | None = None
        config = configs.override(configs.resolve(s.config), list(s.assignments))
        self._config = config
        if s.mode == "mapping":
            s.map_file.parent.mkdir(parents=True, exist_ok=True)
            self._session = MapSession.open(
                s.map_file, config=config, sequence="ros", background=s.background
            )
            self.closer = self._session.closer
        else:
            with MapStore.open(s.map_file) as store:
                config = with_model_of(store, configs.complete(config))
                self.closer = LoopCloser.from_config(config, background=s.background)
                self.closer.restore(replay_keyframes(store, reopened_session=None))
            self.closer.begin_session()
        self._first_keyframe = len(self.closer.map)
        self.is_located = self._first_keyframe == 0

    @property
    def T_map_odom(self) -> Pose | None:
        """The newest correction of the odometry; None before the first, or if not located."""
        return self.step.T_map_odom if self.step is not None and self.is_located else None

    def process(self, posed: PosedFrame) -> Step | None:
        """Process a frame; None if it was left out, with the reason among ``health.errors``."""
        if self.is_paused or self.is_finished:
            return None
        start_s = time.perf_counter()
        try:
            if isinstance(posed.frame, Cloud):
                step = self.closer.process_points(*posed.frame, posed.T_odom_camera)
            else:
                step = self.closer.process(posed.frame, posed.T_odom_camera, posed.covariance)
        except FrameError as error:
            self.health.errors = [*self.health.errors[-9:], str(error)]
            return None
        self.health.add(step.health, time.perf_counter() - start_s)
        if step.is_keyframe:
            self._chosen.append(posed)
        self._take(step)
        return step

    def poll(self) -> Step | None:
        """Take in what came of keyframes since the last frame; return its step as it is now."""
        if self.is_finished:
            return self.step
        step = self.closer.poll()
        if step is not None:
            self._take(step)
        return step

    def _take(self, step: Step) -> None:
        self.step = step
        self.is_located |= any(loop.match_id < self._first_keyframe for loop in step.loops)
        if step.keyframe is not None:
            newest_s = step.keyframe.stamp_s
            self._arrived += [p for p in self._chosen if p.frame.stamp_s <= newest_s]
            self._chosen = [p for p in self._chosen if p.frame.stamp_s > newest_s]

    def take_keyframes(self) -> list[PosedFrame]:
        """Return the frames whose keyframes have come into the map since the last call."""
        taken, self._arrived = self._arrived, []
        return taken

    def outline(self) -> MapOutline:
        """Return the map, once all keyframes so far are in it.

        In the background it may be called in another thread.
        """
        return self.closer.map.outline()

    def occupancy(self, map_: MapOutline, n_most: int) -> OccupancyGrid:
        """Return the occupancy grid of the largest component, by up to ``n_most`` keyframes.

        Raises
        ------
        MapError
            If they show nothing to draw.
        """
        ids, frames = self._depth_frames(n_most)
        largest = np.bincount(map_.components).argmax()
        drawn = [
            (frame, map_.T_map_camera[k])
            for k, frame in zip(ids, frames, strict=True)
            if k < len(map_.components) and map_.components[k] == largest
        ]
        return build_occupancy_grid(
            [frame for frame, _ in drawn],
            np.array([T for _, T in drawn]).reshape(-1, 4, 4),
            gravity_map=self._config.gravity_odom,
        )

    def _depth_frames(self, n_most: int) -> tuple[list[int], list[DepthFrame]]:
        """Return ids and depth of up to ``n_most`` saved keyframes, evenly chosen."""
        with MapStore.open(self.settings.map_file) as store:
            ids = [row["keyframe_id"] for row in store.select("SELECT keyframe_id FROM views")]
            ids = sorted(ids)[:: -(-len(ids) // n_most) or 1]
            views = {k: store.view(k) for k in ids}
        known = {k: view for k, view in views.items() if view is not None}
        return list(known), list(known.values())

    def save(self, path: Path) -> int:
        """Save a finished copy of the map, and go on; return its number of keyframes.

        Raises
        ------
        MapError
            If there is nothing to save, as in ``localization``, or it cannot be written.
        """
        if self._session is None:
            raise MapError(f"{self.settings.map_file}: in localization the map is not written")
        if not self.is_finished:
            self._session.wait()
        new = path.with_name(f".{path.name}.new")
        with ExitStack() as stack:
            stack.callback(new.unlink, missing_ok=True)
            if self.is_finished:
                shutil.copyfile(self.settings.map_file, new)
            else:
                self._session.store.copy_to(new)
            with MapStore.open(new, read_only=False) as store:
                finish_map(store)
                n_keyframes = len(store.keyframes())
            new.replace(path)
        return n_keyframes

    def finish(self) -> int:
        """Optimise the whole map and close it; return the number of frames of the session."""
        if self.is_finished:
            return 0
        self.is_finished = True
        trajectory = self.closer.finish() if self._session is None else self._session.finish()
        return len(trajectory)

    def reset(self) -> None:
        """Finish, and begin another session of the map, as after a restart of the odometry."""
        self.finish()
        self.closer.close()
        self._open()
        self.is_finished = False
